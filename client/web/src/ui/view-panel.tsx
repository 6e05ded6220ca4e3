// SPDX-License-Identifier: MIT
// View: exposure, tone curve, background, the part of the light that is shown, pictures to keep.
import { HEATS, TERMS, TONES, type Heat, type Term, type Tone } from "../state/scene-state";
import { ComparePanel } from "./compare";
import { Choice, Icon, Section, Slider } from "./controls";
import { change, commit, resetOrbit, scene, screenshot, set, status, viewer } from "./store";
import type { Vec3 } from "../scene/camera";

const TERM_NAMES: Record<Term, string> = {
  total: "All",
  multiple: "Multiple",
  single: "Single",
  irradiance: "Irradiance",
};
const HEAT_NAMES: Record<Heat, string> = {
  thickness: "Thickness",
  error: "Error",
  dipole: "Dipole",
};
const TONE_NAMES: Record<Tone, string> = {
  filmic: "Filmic",
  reinhard: "Reinhard",
  none: "Linear",
};
const BACKGROUNDS: { value: string; label: string; background: "environment" | Vec3 }[] = [
  { value: "dark", label: "Dark", background: [0.018, 0.019, 0.022] },
  { value: "grey", label: "Grey", background: [0.18, 0.18, 0.18] },
  { value: "light", label: "Light", background: [1.6, 1.58, 1.54] },
  { value: "environment", label: "Environment", background: "environment" },
];

function show(value: Term | Heat): void {
  const { heat, ...rest } = scene.value;
  const heats = HEATS.find((one) => one === value);
  scene.value = heats ? { ...rest, heat: heats } : { ...rest, term: value as Term };
  if (heat !== scene.value.heat || rest.term !== scene.value.term) commit();
}
function thicknessText(): string {
  const most = viewer?.thickestMm ?? 0;
  if (status.value.mode !== "mesh")
    return "Thickness is drawn where the page has the surface; the daemon draws this model.";
  return (
    `How much of each line of sight is inside the model: blue 0, yellow ${most.toPrecision(2)} mm ` +
    "and more; red where the surface is open."
  );
}
function errorText(): string {
  const places = viewer?.errorPlaces;
  if (!places)
    return "Nobody measured where this model's light errs: it has no bake, or one of an older version.";
  const percent = (100 * (viewer?.mostError ?? 0)).toPrecision(2);
  return (
    `How far the bake is from the exact sum: blue 0, yellow ${percent} % of the model's mean ` +
    `brightness. Measured at ${places.vertex.length} vertices under an even sky, three soft boxes and a ` +
    "small sun (the root mean square), interpolated between them."
  );
}

function signedPercent(ratio: number): string {
  return `${ratio < 0 ? "−" : "+"}${Math.round(100 * Math.abs(ratio))}`;
}
function dipoleText(): string {
  const dipole = viewer?.dipoleError;
  if (!dipole)
    return (
      "The dipole was not compared with random walks in this model: its medium is free, its surface " +
      "is open, or it has no bake."
    );
  return (
    "The dipole, which takes the surface for a plane, against random walks under an even sky: white " +
    "equal, red too bright, blue too dark, full at a factor of two. It is " +
    `${Math.round(100 * dipole.rms)} % off, beyond ${signedPercent(dipole.darkest)} to ` +
    `${signedPercent(dipole.brightest)} % at one vertex in fifty. This bake is by ` +
    `${viewer?.byWalks ? "walks" : "the dipole"}.`
  );
}

export function ViewPanel() {
  const { exposure, tone, term, background, heat } = scene.value;
  const shown =
    BACKGROUNDS.find((one) => JSON.stringify(one.background) === JSON.stringify(background))
      ?.value ?? "";
  return (
    <>
      <Section title="Picture">
        <Slider
          label="Exposure"
          unit="EV"
          min={-8}
          max={8}
          value={exposure}
          onInput={(x) => change({ exposure: Math.round(x * 20) / 20 })}
          onDone={commit}
        />
        <Choice
          label="Tone curve"
          value={tone}
          options={TONES.map((value) => ({ value, label: TONE_NAMES[value] }))}
          onChange={(value) => set({ tone: value })}
        />
      </Section>
      <Section title="Background">
        <Choice
          label="Background"
          value={shown}
          options={BACKGROUNDS}
          onChange={(value) => {
            const one = BACKGROUNDS.find((each) => each.value === value);
            if (one) set({ background: one.background });
          }}
        />
      </Section>
      <Section title="Light that is shown">
        <Choice
          label="Term"
          value={heat ?? term}
          options={[
            ...TERMS.map((value) => ({ value, label: TERM_NAMES[value] })),
            ...(status.value.mode === "mesh" || heat
              ? HEATS.map((value) => ({ value, label: HEAT_NAMES[value] }))
              : []),
          ]}
          onChange={(value) => show(value)}
        />
        <p class="hint">
          {heat === "thickness" && thicknessText()}
          {heat === "error" && errorText()}
          {heat === "dipole" && dipoleText()}
          {!heat &&
            term === "total" &&
            "Scattered light and reflections, as a camera sees them."}
          {!heat && term === "multiple" && "Light that scattered many times in the medium."}
          {!heat && term === "single" && "Light that scattered once."}
          {!heat &&
            term === "irradiance" &&
            "Light that arrives at the surface; it is traced and takes seconds."}
        </p>
      </Section>
      <ComparePanel />
      <Section title="Keep">
        <div class="row">
          <button type="button" onClick={() => void screenshot("png")}>
            <Icon name="camera" /> PNG
          </button>
          <button type="button" onClick={() => void screenshot("exr")}>
            EXR, linear
          </button>
          <button type="button" onClick={resetOrbit}>
            <Icon name="reset" /> Reset the camera
          </button>
        </div>
      </Section>
    </>
  );
}
