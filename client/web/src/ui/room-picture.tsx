// SPDX-License-Identifier: MIT
// Pictures of scenes that the room keeps, with what was drawn on them, and their differences.
import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import type { Stroke, SurfacePoint } from "../gen/relight_pb";
import { state } from "../room/here";
import {
  compared,
  pictureOf,
  presentKey,
  type Compared,
  type Kept,
  type Size,
} from "../room/pictures";
import { project } from "../room/pick";
import { placedOf } from "../room/convert";
import { css } from "../room/here";
import { MAP_MOST, heat } from "../scene/color-difference";
import { explain } from "../protocol/errors";
import { connection } from "./store";

const keyOf = (what: Kept) =>
  `${String(what.pin ?? "")}/${String(what.decision ?? "")}/${String(what.revision ?? "")}`;
const SMALL: Size = { width: 480, height: 360 };

const changesWith = (what: Kept) =>
  what.pin || what.decision || what.revision ? "" : presentKey();

// A picture that cannot be drawn says why in its place: its model may have been deleted.
function Undrawn({ why }: { why: string }) {
  return (
    <p class="warning" role="status">
      This cannot be drawn: {why}
    </p>
  );
}
function reasonOf(error: unknown): string {
  const { text, remedy } = explain(error);
  return [text, remedy].filter(Boolean).join(". ");
}
// Pictures are asked for again when the connection is back.
const isReady = () => connection.value.is === "ready";

export function Picture(props: { what: Kept; alt: string; size?: Size }) {
  const address = useSignal("");
  const why = useSignal("");
  const { what, size = SMALL } = props;
  useEffect(() => {
    let live = true;
    address.value = why.value = "";
    pictureOf(what, size).then(
      (url) => {
        if (live) address.value = url;
      },
      (error: unknown) => {
        if (live) why.value = reasonOf(error);
      },
    );
    return () => (live = false);
  }, [keyOf(what), changesWith(what), isReady()]);
  if (why.value) return <Undrawn why={why.value} />;
  return address.value ? (
    <img class="seen" src={address.value} alt={props.alt} />
  ) : (
    <div class="seen wait" role="status" aria-label="The daemon draws the picture" />
  );
}

/** A pin and its strokes over a picture of a revision, seen through its camera. */
export function MarksOver(props: {
  at: SurfacePoint | undefined;
  strokes: readonly Stroke[];
  revision: number;
}) {
  const scene = state.value?.revisions.find((one) => one.number === props.revision)?.scene;
  const placed = placedOf(scene?.camera);
  if (!placed) return null;
  const { width, height } = SMALL;
  const onPicture = ({ position: p }: SurfacePoint) =>
    p ? project(placed, [p.x, p.y, p.z], width, height) : null;
  const pin = props.at && onPicture(props.at);
  return (
    <svg class="over" viewBox={`0 0 ${width} ${height}`} aria-hidden="true">
      {pin && <circle cx={pin.x.toFixed(1)} cy={pin.y.toFixed(1)} r={7} />}
      {props.strokes.map((stroke) => {
        const points = (stroke.line?.points ?? []).flatMap((point) => {
          const at = onPicture(point);
          return at ? [`${at.x.toFixed(1)},${at.y.toFixed(1)}`] : [];
        });
        return (
          <polyline
            key={String(stroke.stamp?.sequence)}
            points={points.join(" ")}
            stroke={css(stroke.line?.color ?? 0)}
            stroke-width={((stroke.line?.width ?? 3) * width) / 960}
          />
        );
      })}
    </svg>
  );
}

/** Where two scenes of the room differ, as a map of ΔE₀₀ with its numbers. */
export function DifferencePicture(props: { a: Kept; b: Kept; size?: Size }) {
  const { a, b, size = { width: 240, height: 180 } } = props;
  const canvas = useRef<HTMLCanvasElement>(null);
  const found = useSignal<Compared | null>(null);
  const why = useSignal("");
  useEffect(() => {
    let live = true;
    found.value = null;
    why.value = "";
    const show = (result: Compared) => {
      const node = canvas.current;
      if (!live || !node) return;
      node.width = result.width;
      node.height = result.height;
      node
        .getContext("2d")
        ?.putImageData(new ImageData(result.map, result.width, result.height), 0, 0);
      found.value = result;
    };
    compared(a, b, size).then(show, (error: unknown) => {
      if (live) why.value = reasonOf(error);
    });
    return () => (live = false);
  }, [keyOf(a), keyOf(b), changesWith(a), changesWith(b), isReady()]);
  if (why.value) return <Undrawn why={why.value} />;
  const numbers = found.value;
  const ramp = [0, 0.2, 0.4, 0.6, 0.8, 1].map((x) => `rgb(${heat(x).join(" ")})`).join(", ");
  return (
    <figure class={`difference ${numbers ? "" : "wait"}`}>
      <canvas ref={canvas} class="seen" role="img" aria-label="Map of the difference" />
      <figcaption>
        {numbers ? (
          <>
            ΔE₀₀ mean {numbers.mean.toFixed(2)}, most {numbers.most.toFixed(1)};{" "}
            {(100 * numbers.seen).toFixed(0)} % above 2.3
          </>
        ) : (
          "The daemon draws both."
        )}
        <i
          class="ramp"
          title={`0 to ${MAP_MOST}`}
          style={{ background: `linear-gradient(90deg, ${ramp})` }}
        />
      </figcaption>
    </figure>
  );
}
