// SPDX-License-Identifier: MIT
// Light: the gallery of environments, and turn, height, strength and colour of each lamp.
import { useEffect, useRef } from "preact/hooks";
import { BUILTIN_LIGHTS } from "../scene/builtin-lights";
import { roomId } from "../room/here";
import { thumbnail } from "../scene/thumbnails";
import { brightened, hexOf, strengthOf, tinted } from "../state/lamp-gain";
import { arrowKeys, Icon, IconButton, Section, Slider } from "./controls";
import { FileInput } from "./file-input";
import {
  addLamp,
  chosenIndex,
  chosenLamp,
  client,
  commit,
  environments,
  mayUpload,
  removeLamp,
  scene,
  set,
  setLamp,
} from "./store";

function Ball({ env }: { env: string }) {
  const canvas = useRef<HTMLCanvasElement>(null);
  useEffect(() => {
    let live = true;
    thumbnail(client, env)
      .then((pixels) => {
        if (live) canvas.current?.getContext("2d")?.putImageData(pixels, 0, 0);
      })
      .catch(() => undefined);
    return () => {
      live = false;
    };
  }, [env]);
  return <canvas ref={canvas} class="ball" width={88} height={88} aria-hidden="true" />;
}

export function environmentName(env: string): string {
  const builtin = BUILTIN_LIGHTS.find((light) => `page:${light.id}` === env);
  if (builtin) return builtin.name;
  if (env.startsWith("constant")) return "Even";
  const known = environments.value.find((entry) => entry.env === env);
  return known?.name.replace(/\.[a-z]+$/i, "") || `${env.slice(4, 10)}…`;
}

// A room has lights that its daemon has: the page's own are offered to those who may upload.
function gallery(): string[] {
  const shown = scene.value.lamps.map(({ env }) => env);
  const own = BUILTIN_LIGHTS.map((light) => `page:${light.id}`);
  return [
    ...own.filter((env) => !roomId.value || mayUpload.value || shown.includes(env)),
    "constant",
    ...environments.value.map((entry) => entry.env),
  ];
}

function Tint({ index }: { index: number }) {
  const lamp = scene.value.lamps[index];
  if (!lamp) return null;
  const gain = () => scene.value.lamps[index]?.gain ?? lamp.gain;
  return (
    <label class="tint">
      Colour
      <input
        type="color"
        value={hexOf(lamp.gain)}
        onInput={(event) => setLamp(index, { gain: tinted(gain(), event.currentTarget.value) })}
        onChange={(event) => {
          event.currentTarget.value = hexOf(gain()); // black was chosen, which is no colour of a light
          commit();
        }}
      />
    </label>
  );
}

function Lamp({ index }: { index: number }) {
  const lamp = scene.value.lamps[index];
  if (!lamp) return null;
  const many = scene.value.lamps.length > 1;
  return (
    <Section
      title={many ? `Light ${index + 1}: ${environmentName(lamp.env)}` : "Direction"}
      aside={
        many && (
          <IconButton
            icon="close"
            label={`Remove light ${index + 1}`}
            onClick={() => removeLamp(index)}
          />
        )
      }
    >
      <Slider
        label="Turn"
        unit="°"
        min={0}
        max={360}
        value={lamp.rotate}
        onInput={(rotate) => setLamp(index, { rotate })}
        onDone={commit}
      />
      {!roomId.value && (
        <Slider
          label="Height"
          unit="°"
          min={-90}
          max={90}
          value={lamp.tilt}
          onInput={(tilt) => setLamp(index, { tilt: Math.round(tilt) })}
          onDone={commit}
        />
      )}
      <Slider
        label="Strength"
        unit="EV"
        min={-6}
        max={6}
        digits={2}
        value={strengthOf(lamp.gain)}
        onInput={(ev) => setLamp(index, { gain: brightened(lamp.gain, ev) })}
        onDone={commit}
      />
      <Tint index={index} />
    </Section>
  );
}

export function LightPanel() {
  const { lamps } = scene.value;
  const index = chosenIndex();
  const choose = (env: string) =>
    set({ lamps: lamps.map((lamp, i) => (i === index ? { ...lamp, env } : lamp)) });
  return (
    <>
      <Section title="Environment">
        {lamps.length > 1 && (
          <div
            class="choice"
            role="radiogroup"
            aria-label="Which light is chosen here"
            onKeyDown={arrowKeys}
          >
            {lamps.map((_, i) => (
              <button
                key={i}
                type="button"
                role="radio"
                aria-checked={i === index}
                onClick={() => (chosenLamp.value = i)}
              >
                Light {i + 1}
              </button>
            ))}
          </div>
        )}
        <div class="gallery" role="radiogroup" aria-label="Environment" onKeyDown={arrowKeys}>
          {gallery().map((env) => (
            <button
              key={env}
              type="button"
              class="card"
              role="radio"
              aria-checked={lamps[index]?.env === env}
              onClick={() => choose(env)}
            >
              <Ball env={env} />
              <span>{environmentName(env)}</span>
            </button>
          ))}
          {mayUpload.value && (
            <label class="card add">
              <span class="ball">
                <Icon name="plus" />
              </span>
              <span>HDR, EXR…</span>
              <FileInput accept=".hdr,.exr,.png,.jpg,.jpeg" />
            </label>
          )}
        </div>
      </Section>
      {lamps.map((_, i) => (
        <Lamp key={i} index={i} />
      ))}
      {lamps.length < 4 && (
        <button type="button" class="quiet" onClick={addLamp}>
          <Icon name="plus" /> Another light
        </button>
      )}
    </>
  );
}
