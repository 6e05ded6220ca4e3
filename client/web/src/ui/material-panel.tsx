// SPDX-License-Identifier: MIT
// Material: presets, and the medium's numbers, by coefficients or by colour and mean free path.
import { useSignal } from "@preact/signals";
import {
  ANY_ETA,
  fromColor,
  mediumText,
  parseMedium,
  PRESET_NAMES,
  toColor,
  type Medium,
} from "../state/material";
import { arrowKeys, Choice, Section, Slider } from "./controls";
import {
  change,
  commit,
  editedObject,
  editObject,
  etaIsOpen,
  info,
  materialIsOpen,
  medium,
  mediumTextShown,
  notice,
  objects,
  scene,
  set,
  withMedium,
} from "./store";

type Rgb = [number, number, number];
const CHANNELS = ["red", "green", "blue"] as const;
const NAMES: Record<string, string> = {
  chicken1: "Chicken",
  chicken2: "Chicken, dark",
  skimmilk: "Skim milk",
  wholemilk: "Whole milk",
  skin1: "Skin",
  skin2: "Skin, light",
};
const title = (preset: string) =>
  NAMES[preset] ?? preset.charAt(0).toUpperCase() + preset.slice(1);

function Triple(props: {
  label: string;
  unit: string;
  value: Rgb;
  min: number;
  max: number;
  log?: boolean;
  field: string;
  onInput: (value: Rgb) => void;
}) {
  const refused = notice.value?.text ?? "";
  return (
    <fieldset class="triple">
      <legend>
        {props.label} <span class="unit">{props.unit}</span>
      </legend>
      {CHANNELS.map((tone, c) => (
        <Slider
          key={tone}
          label={tone.charAt(0).toUpperCase() + tone.slice(1)}
          tone={tone}
          min={props.min}
          max={props.max}
          log={props.log ?? false}
          value={props.value[c] ?? 0}
          {...(refused.includes(`${props.field}[${c}]`) ? { warning: refused } : {})}
          onInput={(x) => props.onInput(props.value.map((y, i) => (i === c ? x : y)) as Rgb)}
          onDone={commit}
        />
      ))}
    </fieldset>
  );
}

function Numbers({ medium: m }: { medium: Medium }) {
  const by = useSignal<"coefficients" | "colour">("colour");
  const put = (part: Partial<Medium>) =>
    change(withMedium(mediumText({ ...m, ...part, name: "" })));
  const { color, freePath } = toColor(m);
  return (
    <>
      <Choice
        label="How the medium is given"
        value={by.value}
        options={[
          { value: "colour", label: "Colour, depth" },
          { value: "coefficients", label: "σs′, σa" },
        ]}
        onChange={(value) => (by.value = value)}
      />
      {by.value === "colour" ? (
        <>
          <Triple
            label="Diffuse colour"
            unit="albedo"
            field="sigma_a"
            value={color}
            min={0.01}
            max={0.99}
            onInput={(c) => change(withMedium(mediumText(fromColor(c, freePath, m))))}
          />
          <Triple
            label="Mean free path"
            unit="mm"
            field="sigma_s_prime"
            value={freePath}
            min={0.02}
            max={20}
            log
            onInput={(p) => change(withMedium(mediumText(fromColor(color, p, m))))}
          />
        </>
      ) : (
        <>
          <Triple
            label="Reduced scattering σs′"
            unit="mm⁻¹"
            field="sigma_s_prime"
            value={m.sigmaSPrime}
            min={0.01}
            max={30}
            log
            onInput={(sigmaSPrime) => put({ sigmaSPrime })}
          />
          <Triple
            label="Absorption σa"
            unit="mm⁻¹"
            field="sigma_a"
            value={m.sigmaA}
            min={0.0001}
            max={3}
            log
            onInput={(sigmaA) => put({ sigmaA })}
          />
        </>
      )}
      {etaIsOpen.value && (
        <Slider
          label="Refractive index η"
          {...ANY_ETA}
          value={m.eta}
          onInput={(eta) => put({ eta: Math.round(eta * 1000) / 1000 })}
          onDone={commit}
        />
      )}
      <Slider
        label="Roughness"
        min={0.02}
        max={1}
        value={m.roughness}
        onInput={(roughness) => put({ roughness })}
        onDone={commit}
      />
      <Slider
        label="Anisotropy g"
        min={-0.9}
        max={0.9}
        value={m.g[0]}
        onInput={(g) => put({ g: [g, g, g] })}
        onDone={commit}
      />
    </>
  );
}

// A bake for one refractive index refuses media of others.
function Presets(props: { shown: string; medium: Medium | null; own: boolean }) {
  const { shown, medium: m, own } = props;
  const fits = (name: string) =>
    etaIsOpen.value || !m || Math.abs((parseMedium(name)?.eta ?? m.eta) - m.eta) < 1e-6;
  const refused = PRESET_NAMES.filter((name) => !fits(name));
  return (
    <>
      <div class="chips" role="radiogroup" aria-label="Preset" onKeyDown={arrowKeys}>
        {PRESET_NAMES.map((name) => (
          <button
            key={name}
            type="button"
            role="radio"
            aria-checked={shown === name || (m?.name === name && own)}
            disabled={!fits(name)}
            onClick={() => set(withMedium(name))}
          >
            {title(name)}
          </button>
        ))}
      </div>
      {m && refused.length > 0 && (
        <p class="hint">
          This bake is for the refractive index {m.eta}: {refused.map(title).join(", ")} have
          another. Bring the model here with its medium open to edit that, too.
        </p>
      )}
    </>
  );
}

// Which object's medium is edited, where there are several; a dot marks those with one of their own.
function Objects() {
  if (!objects.value.length) return null;
  const { materials } = scene.value;
  const others = Object.keys(materials).length ? "Others" : "All";
  const choices = [
    { name: "", label: others },
    ...objects.value.map(({ name }) => ({ name, label: materials[name] ? `${name} •` : name })),
  ];
  return (
    <div class="chips" role="radiogroup" aria-label="Object" onKeyDown={arrowKeys}>
      {choices.map(({ name, label }) => (
        <button
          key={name}
          type="button"
          role="radio"
          aria-checked={editedObject.value === name}
          onClick={() => editObject(name)}
        >
          {label}
        </button>
      ))}
    </div>
  );
}

// The variants of the model's file. One that its bake does not hold for is refused with a notice.
function Variants() {
  const names = info.value?.variants ?? [];
  if (!names.length) return null;
  const { variant } = scene.value;
  return (
    <Section title="Variant">
      <div class="chips" role="radiogroup" aria-label="Variant" onKeyDown={arrowKeys}>
        {["", ...names].map((name) => (
          <button
            key={name}
            type="button"
            role="radio"
            aria-checked={variant === name}
            onClick={() => set({ variant: name })}
          >
            {name || "As loaded"}
          </button>
        ))}
      </div>
    </Section>
  );
}

function Material() {
  if (!info.value) return <p class="hint">Choose a model first.</p>;
  const m = medium.value;
  const shown = mediumTextShown.value;
  const object = editedObject.value;
  const { material, materials } = scene.value;
  const edited = object ? materials[object] : material;
  if (!materialIsOpen.value)
    return (
      <Section title="Material">
        <p class="fixed-medium">
          <b>{m?.name ? title(m.name) : "A medium of its own"}</b>
        </p>
        <p class="hint">
          This bake holds one medium, so that it is small and exact. Load the model without a
          material to edit it freely: its bake then leaves the medium open.
        </p>
        {m && (
          <dl class="facts">
            <dt>σs′</dt>
            <dd>{m.sigmaSPrime.join(", ")} mm⁻¹</dd>
            <dt>σa</dt>
            <dd>{m.sigmaA.join(", ")} mm⁻¹</dd>
            <dt>η</dt>
            <dd>{m.eta}</dd>
            <dt>Roughness</dt>
            <dd>{m.roughness}</dd>
          </dl>
        )}
      </Section>
    );
  return (
    <Section title="Material">
      <Objects />
      <Presets shown={shown} medium={m} own={!edited?.startsWith("{")} />
      {m ? (
        <Numbers medium={m} />
      ) : (
        <p class="hint">This medium is a profile of another kind.</p>
      )}
      {edited && (
        <button type="button" class="quiet" onClick={() => set(withMedium(""))}>
          {object && material ? "As the others" : "The model's own medium"}
        </button>
      )}
    </Section>
  );
}

export function MaterialPanel() {
  return (
    <>
      <Variants />
      <Material />
    </>
  );
}
