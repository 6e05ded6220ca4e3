// SPDX-License-Identifier: MIT
// Small controls that the panels are made of.
import type { ComponentChildren } from "preact";
import { useEffect, useId, useLayoutEffect, useRef } from "preact/hooks";

export function Section(props: {
  title: string;
  children: ComponentChildren;
  aside?: ComponentChildren;
}) {
  return (
    <section class="section">
      <header>
        <h2>{props.title}</h2>
        {props.aside}
      </header>
      {props.children}
    </section>
  );
}

/** Escape closes what is there, from before it can have the focus. */
export function useEscape(isThere: boolean, close: () => void): void {
  useLayoutEffect(() => {
    if (!isThere) return undefined;
    const stop = new AbortController();
    const { signal } = stop;
    addEventListener("keydown", (event) => event.key === "Escape" && close(), { signal });
    return () => stop.abort();
  }, [isThere]);
}

const STEPS_OF: Partial<Record<string, number>> = {
  ArrowLeft: -1,
  ArrowUp: -1,
  ArrowRight: 1,
  ArrowDown: 1,
};
const CHOOSABLE = '[role="tab"], [role="radio"]:not(:disabled)';
/** Arrow keys go to the next of a group of tabs or radio buttons, and choose it. */
export function arrowKeys(event: KeyboardEvent & { currentTarget: HTMLElement }): void {
  const by = STEPS_OF[event.key];
  if (!by || event.ctrlKey || event.metaKey || event.altKey || event.shiftKey) return;
  const all = [...event.currentTarget.querySelectorAll<HTMLElement>(CHOOSABLE)];
  const at = all.findIndex((one) => one === event.target);
  if (at < 0) return;
  event.preventDefault();
  const next = all[(at + by + all.length) % all.length];
  next?.focus();
  next?.click();
}

/** Gives the focus to what appears, and back to where it was when that goes with the focus in it. */
export function useFocus(node: { current: HTMLElement | null }, isThere = true): void {
  // Before the browser draws: what becomes inert behind it loses the focus then.
  useLayoutEffect(() => {
    const now = isThere ? node.current : null;
    if (!now) return undefined;
    const before = document.activeElement;
    now.focus();
    return () => {
      const { activeElement: last } = document; // the body: it had the focus and is gone
      if (last !== document.body && !now.contains(last)) return;
      // What was behind it may be inert until all is drawn.
      setTimeout(() => before instanceof HTMLElement && before.focus());
    };
  }, [isThere]);
}

/** A list beside the picture, over it; Escape closes it. */
export function Drawer(props: {
  title: string;
  /** The label of the button that closes it. */
  closeLabel: string;
  close: () => void;
  children: ComponentChildren;
}) {
  const { title, closeLabel, close } = props;
  const node = useRef<HTMLElement>(null);
  useEscape(true, close);
  useFocus(node);
  return (
    <aside ref={node} class="drawer" aria-label={title} tabIndex={-1}>
      <header>
        <h2>{title}</h2>
        <IconButton icon="close" label={closeLabel} onClick={close} />
      </header>
      {props.children}
    </aside>
  );
}

/** A link to copy by hand: all of it is selected. */
export function LinkField(props: { label: string; url: string }) {
  const field = useRef<HTMLInputElement>(null);
  useEffect(() => {
    field.current?.focus();
    field.current?.select();
  }, [props.url]);
  return (
    <input
      ref={field}
      class="link"
      aria-label={props.label}
      readOnly
      value={props.url}
      onFocus={(event) => event.currentTarget.select()}
    />
  );
}

interface SliderProps {
  label: string;
  value: number;
  min: number;
  max: number;
  /** The slider is in the logarithm of the value. */
  log?: boolean;
  step?: number;
  unit?: string;
  digits?: number;
  /** A colour that marks the channel. */
  tone?: "red" | "green" | "blue";
  /** Why the value is refused or inexact; marks the row. */
  warning?: string;
  disabled?: boolean;
  onInput: (value: number) => void;
  onDone: () => void;
}
const STEPS = 1000;

/** A slider with its number beside it: both can be edited. */
export function Slider(props: SliderProps) {
  const id = useId();
  const { value, min, max, log } = props;
  const least = log ? Math.log(min) : min;
  const most = log ? Math.log(max) : max;
  const here = log ? Math.log(Math.max(min, value)) : value;
  const position = ((here - least) / (most - least)) * STEPS;
  const shown = Number(value.toPrecision(props.digits ?? 3));
  const slide = (event: { currentTarget: HTMLInputElement }) => {
    const x = least + (Number(event.currentTarget.value) / STEPS) * (most - least);
    props.onInput(log ? Math.exp(x) : x);
  };
  const type = (event: { currentTarget: HTMLInputElement }) => {
    const field = event.currentTarget;
    const x = field.value === "" ? NaN : Number(field.value);
    field.value = String(shown); // what is not taken does not stay
    if (!Number.isFinite(x)) return;
    props.onInput(Math.min(max, Math.max(min, x)));
    props.onDone();
  };
  return (
    <div class={`slider ${props.tone ?? ""} ${props.warning ? "warned" : ""}`}>
      <label for={id}>{props.label}</label>
      <input
        id={id}
        type="range"
        min={0}
        max={STEPS}
        step={1}
        value={position}
        disabled={props.disabled}
        aria-valuetext={`${shown}${props.unit ? ` ${props.unit}` : ""}`}
        style={{ "--fill": `${Math.min(100, Math.max(0, position / 10))}%` }}
        onInput={slide}
        onChange={props.onDone}
      />
      <span class="number">
        <input
          type="number"
          aria-label={`${props.label}, number`}
          value={shown}
          min={min}
          max={max}
          step={props.step ?? "any"}
          disabled={props.disabled}
          onChange={type}
        />
        {props.unit && <span class="unit">{props.unit}</span>}
      </span>
      {props.warning && <p class="warning">{props.warning}</p>}
    </div>
  );
}

export function Choice<T extends string>(props: {
  label: string;
  value: T;
  options: readonly { value: T; label: string }[];
  onChange: (value: T) => void;
}) {
  return (
    <div class="choice" role="radiogroup" aria-label={props.label} onKeyDown={arrowKeys}>
      {props.options.map((option) => (
        <button
          key={option.value}
          type="button"
          role="radio"
          aria-checked={option.value === props.value}
          onClick={() => props.onChange(option.value)}
        >
          {option.label}
        </button>
      ))}
    </div>
  );
}

const ICONS = {
  undo: "M9 7H15a4 4 0 0 1 0 8H8M9 7l3-3M9 7l3 3",
  redo: "M15 7H9a4 4 0 0 0 0 8h7M15 7l-3-3M15 7l-3 3",
  share:
    "M10 14a4 4 0 0 0 5.6 0l3-3a4 4 0 0 0-5.6-5.6l-1 1M14 10a4 4 0 0 0-5.6 0l-3 3A4 4 0 0 0 11 18.6l1-1",
  camera: "M4 8h3l2-3h6l2 3h3v11H4zM12 16.5a3.5 3.5 0 1 0 0-7 3.5 3.5 0 0 0 0 7z",
  plus: "M12 5v14M5 12h14",
  close: "M6 6l12 12M18 6L6 18",
  reset: "M5 12a7 7 0 1 1 2 5M5 12V7M5 12h5",
  spin: "M19 12a7 7 0 1 1-7-7c3 0 5 1.5 6 4M19 4v5h-5",
  compare: "M12 4v16M5 7h4v10H5zM15 7h4v10h-4z",
  models: "M12 3l8 4.5v9L12 21l-8-4.5v-9zM12 12l8-4.5M12 12v9M12 12L4 7.5",
} as const;
export type IconName = keyof typeof ICONS;

export function Icon({ name }: { name: IconName }) {
  return (
    <svg class="icon" viewBox="0 0 24 24" aria-hidden="true">
      <path d={ICONS[name]} />
    </svg>
  );
}
export function IconButton(props: {
  icon: IconName;
  label: string;
  disabled?: boolean;
  pressed?: boolean;
  onClick: () => void;
}) {
  return (
    <button
      type="button"
      class="icon-button"
      title={props.label}
      aria-label={props.label}
      aria-pressed={props.pressed}
      disabled={props.disabled}
      onClick={props.onClick}
    >
      <Icon name={props.icon} />
    </button>
  );
}
