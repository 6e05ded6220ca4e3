// SPDX-License-Identifier: MIT
// The room's revisions: who saved what and when, any two of them compared, any one shown again.
import { useSignal } from "@preact/signals";
import { useRef } from "preact/hooks";
import type { Revision } from "../gen/relight_pb";
import { act } from "../room/edits";
import { apart, mayReview, state } from "../room/here";
import type { Kept } from "../room/pictures";
import { bringBack, putDown, showAlone } from "../room/share";
import { lookAlone } from "../room/session";
import { Choice, IconButton, Section, useEscape, useFocus } from "./controls";
import { draftOf, sendDraft } from "./drafts";
import { byOf, comparing, revisionNow, timeOf } from "./review-state";
import { DifferencePicture, Picture } from "./room-picture";
import { set } from "./store";

const FEW = 8;
const LARGE = { width: 960, height: 720 };

function look(one: Revision): void {
  lookAlone(true);
  if (one.scene) showAlone(one.scene);
}

function Row({ one, now }: { one: Revision; now: number }) {
  return (
    <li>
      <b>
        Revision {one.number}
        {one.number === now && ", as it is now"}
      </b>
      <small>
        {byOf(one.stamp)}, {timeOf(one.stamp)}
      </small>
      {one.note && <p>{one.note}</p>}
      <div class="row">
        <button type="button" class="quiet" onClick={() => look(one)}>
          Look
        </button>
        {one.number !== now && (
          <button
            type="button"
            class="quiet"
            onClick={() => (comparing.value = { a: { revision: one.number }, b: {} })}
          >
            Compare
          </button>
        )}
        {one.number !== now && mayReview.value && !apart.value && (
          <button type="button" class="quiet" onClick={() => one.scene && bringBack(one.scene)}>
            Bring back
          </button>
        )}
      </div>
    </li>
  );
}

export function Revisions() {
  const draft = draftOf("revision");
  const note = draft.text;
  const all = useSignal(false);
  const now = state.value;
  if (!now) return null;
  const present = revisionNow(now);
  const list = [...now.revisions].reverse();
  const save = () => {
    putDown();
    void sendDraft(draft, (said) => ({ save: { note: said } }));
  };
  return (
    <Section title="Revisions">
      <ul class="decisions revisions">
        {(all.value ? list : list.slice(0, FEW)).map((one) => (
          <Row key={one.number} one={one} now={present} />
        ))}
        {!list.length && <li class="hint">No revision is saved yet.</li>}
      </ul>
      {list.length > FEW && !all.value && (
        <button type="button" class="quiet" onClick={() => (all.value = true)}>
          All {list.length} revisions
        </button>
      )}
      {mayReview.value && !apart.value && (
        <form
          class="decide"
          onSubmit={(event) => {
            event.preventDefault();
            save();
          }}
        >
          <input
            aria-label="Note of the revision"
            placeholder="Note"
            value={note.value}
            onInput={(event) => (note.value = event.currentTarget.value)}
          />
          <button type="submit" disabled={draft.sending.value || present > 0}>
            Save this as a revision
          </button>
        </form>
      )}
    </Section>
  );
}

/** Materials that the room keeps by name: one click shows one. */
export function Variants() {
  const draft = draftOf("variant");
  const name = draft.text;
  const now = state.value;
  if (!now || (!now.variants.length && !mayReview.value)) return null;
  const material = now.scene?.material ?? "";
  return (
    <Section title="Material variants">
      <ul class="pins variants">
        {now.variants.map((one) => (
          <li key={one.name} class="row">
            <button
              type="button"
              class="pin-title"
              aria-pressed={one.material === material}
              onClick={() => set({ material: one.material })}
            >
              {one.name}
            </button>
            {mayReview.value && (
              <IconButton
                icon="close"
                label={`Remove the variant ${one.name}`}
                onClick={() => void act({ variant: { name: one.name, material: "" } })}
              />
            )}
          </li>
        ))}
      </ul>
      {mayReview.value && material && (
        <form
          class="row"
          onSubmit={(event) => {
            event.preventDefault();
            putDown();
            void sendDraft(draft, (said) => ({ variant: { name: said, material } }));
          }}
        >
          <input
            aria-label="Name of the variant"
            placeholder="Name of this material"
            value={name.value}
            onInput={(event) => (name.value = event.currentTarget.value)}
          />
          <button type="submit" disabled={draft.sending.value || !name.value.trim()}>
            Keep
          </button>
        </form>
      )}
    </Section>
  );
}

// ---- two of them

type Mode = "side" | "wipe" | "difference";
const MODES: { value: Mode; label: string }[] = [
  { value: "side", label: "Side by side" },
  { value: "wipe", label: "Wipe" },
  { value: "difference", label: "ΔE map" },
];

function wordOf(what: Kept): string {
  if (what.revision) return `revision ${what.revision}`;
  if (what.decision) {
    const one = state.value?.decisions.find((d) => d.stamp?.sequence === what.decision);
    return one
      ? `${one.approve ? "approved" : "rejected"} at revision ${one.seen?.revision ?? 0}`
      : "";
  }
  return "now";
}

function Pick(props: { label: string; what: Kept; onPick: (what: Kept) => void }) {
  const { what } = props;
  const value = what.decision ? "d" : String(what.revision ?? 0);
  return (
    <label class="picked">
      {props.label}
      <select
        aria-label={props.label}
        value={value}
        onChange={(event) => {
          const picked = event.currentTarget.value;
          if (picked !== "d") props.onPick(Number(picked) ? { revision: Number(picked) } : {});
        }}
      >
        {what.decision && <option value="d">{wordOf(what)}</option>}
        <option value="0">now</option>
        {(state.value?.revisions ?? []).map((one) => (
          <option key={one.number} value={one.number}>
            revision {one.number}
            {one.note && `: ${one.note.slice(0, 40)}`}
          </option>
        ))}
      </select>
    </label>
  );
}

function Both({ mode, at }: { mode: Mode; at: { value: number } }) {
  const both = comparing.value;
  if (!both) return null;
  const { a, b } = both;
  if (mode === "difference") return <DifferencePicture a={a} b={b} size={LARGE} />;
  return (
    <div class={`both ${mode}`} style={{ "--at": `${at.value}%` }}>
      <Picture what={a} alt={`A: ${wordOf(a)}`} size={LARGE} />
      <Picture what={b} alt={`B: ${wordOf(b)}`} size={LARGE} />
      {mode === "wipe" && (
        <input
          type="range"
          aria-label="Wipe"
          min={0}
          max={100}
          value={at.value}
          onInput={(event) => (at.value = Number(event.currentTarget.value))}
        />
      )}
    </div>
  );
}

/** Two scenes of the room as the daemon draws them, over the page. */
export function RevisionCompare() {
  const mode = useSignal<Mode>("side");
  const at = useSignal(50);
  const both = comparing.value;
  const node = useRef<HTMLElement>(null);
  useEscape(both !== null, () => (comparing.value = null));
  useFocus(node, both !== null);
  if (!both) return null;
  return (
    <section
      ref={node}
      class="compare-rooms"
      role="dialog"
      aria-modal="true"
      aria-label="Two revisions"
      tabIndex={-1}
    >
      <header class="row">
        <Pick label="A" what={both.a} onPick={(a) => (comparing.value = { ...both, a })} />
        <Pick label="B" what={both.b} onPick={(b) => (comparing.value = { ...both, b })} />
        <Choice
          label="How they are compared"
          value={mode.value}
          options={MODES}
          onChange={(value) => (mode.value = value)}
        />
        <IconButton
          icon="close"
          label="Close the comparison"
          onClick={() => (comparing.value = null)}
        />
      </header>
      <Both mode={mode.value} at={at} />
    </section>
  );
}
