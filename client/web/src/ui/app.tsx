// SPDX-License-Identifier: MIT
// The page: the picture fills it, the panels lie beside it, or below it on a phone.
import { useSignal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { arrowKeys, Icon, IconButton, LinkField } from "./controls";
import { copyLink, linkToCopy } from "./copy";
import { state as room } from "../room/here";
import { explain, PageError } from "../protocol/errors";
import { duration } from "./duration";
import { FileInput } from "./file-input";
import { LightPanel } from "./light-panel";
import { MaterialPanel } from "./material-panel";
import { Models, UploadSettings } from "./models";
import { Pins } from "./pins";
import { PrintView, ReviewPanel } from "./review-panel";
import { covered, tab } from "./review-state";
import { RevisionCompare } from "./revisions";
import { RoomBar, Rooms, RoomsButton } from "./rooms";
import { StageView } from "./stage-view";
import {
  busy,
  bytesPerSecond,
  canRedo,
  canUndo,
  connection,
  fault,
  info,
  lastUpload,
  linkNow,
  loadUpload,
  mayEdit,
  mayUpload,
  models,
  notice,
  redo,
  scene,
  setOrbit,
  status,
  takeFiles,
  undo,
  uploading,
  useToken,
  viewer,
} from "./store";
import { ViewPanel } from "./view-panel";

const TABS = [
  { id: "light", label: "Light", panel: LightPanel },
  { id: "material", label: "Material", panel: MaterialPanel },
  { id: "view", label: "View", panel: ViewPanel },
] as const;
const REVIEW = { id: "review", label: "Review", panel: ReviewPanel } as const;

function TokenPrompt() {
  const text = useSignal("");
  const remember = useSignal(false);
  return (
    <form
      class="token"
      onSubmit={(event) => {
        event.preventDefault();
        if (text.value.trim()) useToken(text.value.trim(), remember.value);
      }}
    >
      <label for="token">Token</label>
      <input
        id="token"
        type="password"
        autocomplete="off"
        placeholder="relight_…"
        value={text.value}
        onInput={(event) => (text.value = event.currentTarget.value)}
      />
      <label class="check">
        <input
          type="checkbox"
          checked={remember.value}
          onChange={(event) => (remember.value = event.currentTarget.checked)}
        />
        Keep it on this machine
      </label>
      <button type="submit" class="primary">
        Connect
      </button>
      <p class="hint">
        It is kept for this tab only, unless you say so. `relight token create` makes one.
      </p>
    </form>
  );
}

const OFFLINE = {
  title: "Offline",
  text: "The daemon does not answer.",
  remedy: "The page connects again by itself; nothing is lost.",
};

function Notice() {
  const said = notice.value;
  const state = connection.value;
  if (state.is === "offline") {
    const { title, text, remedy } = state.why ? explain(state.why, true) : OFFLINE;
    return (
      <div class="notice" role="status">
        <b>{title}</b>
        <p>{text}</p>
        <p class="remedy">{remedy}</p>
      </div>
    );
  }
  if (!said) return null;
  return (
    <div class={`notice ${said.kind}`} role="alert">
      <b>{said.title}</b>
      <p>{said.text}</p>
      {said.remedy && <p class="remedy">{said.remedy}</p>}
      {state.is === "refused" ? (
        <TokenPrompt />
      ) : (
        <IconButton
          icon="close"
          label="Close this message"
          onClick={() => (notice.value = null)}
        />
      )}
    </div>
  );
}

function LinkToCopy() {
  if (!linkToCopy.value) return null;
  return (
    <div class="notice" role="alert">
      <b>The browser does not copy the link</b>
      <p>Copy it from this field.</p>
      <LinkField label="Link to copy" url={linkToCopy.value} />
      <IconButton
        icon="close"
        label="Close this link"
        onClick={() => (linkToCopy.value = "")}
      />
    </div>
  );
}

function Bar(props: { share: number | null; label: string }) {
  const percent = props.share === null ? undefined : Math.round(100 * props.share);
  return (
    <div
      class={`bar ${props.share === null ? "open" : ""}`}
      role="progressbar"
      aria-label={props.label}
      aria-valuemin={0}
      aria-valuemax={100}
      aria-valuenow={percent}
    >
      <div style={{ width: `${percent ?? 30}%` }} />
    </div>
  );
}

function Work() {
  const sent = uploading.value;
  const { progress } = status.value;
  const last = lastUpload.value;
  if (sent)
    return (
      <div class="work" role="status">
        <p>
          Sending <b>{sent.name}</b>
        </p>
        <Bar share={sent.share} label="Upload" />
        <button
          type="button"
          class="quiet"
          onClick={() => (uploading.value = { ...sent, cancelled: true })}
        >
          Cancel
        </button>
      </div>
    );
  if (progress) {
    const left = progress.etaS > 0 ? `, ${duration(progress.etaS)} left` : "";
    return (
      <div class="work" role="status">
        <p>
          Baking {Math.round(100 * progress.fraction)} %<small>{left}</small>
        </p>
        <Bar share={progress.fraction} label="Bake" />
        {last?.model === info.value?.model && last && (
          <details>
            <summary>Size, axes and medium</summary>
            <UploadSettings />
            <button
              type="button"
              onClick={() => {
                void viewer?.cancelBake().catch(fault);
                void loadUpload(last.name, last.hash).catch(fault);
              }}
            >
              Bake it so
            </button>
          </details>
        )}
        {mayEdit.value && (
          <button
            type="button"
            class="quiet"
            onClick={() => void viewer?.cancelBake().catch(fault)}
          >
            Stop the bake
          </button>
        )}
      </div>
    );
  }
  if (busy.value)
    return (
      <div class="work" role="status">
        <p>{busy.value}</p>
        <Bar share={null} label={busy.value} />
      </div>
    );
  return null;
}

function rate(bytes: number): string {
  return bytes < 1000
    ? `${bytes} B/s`
    : bytes < 1e6
      ? `${(bytes / 1e3).toFixed(0)} kB/s`
      : `${(bytes / 1e6).toFixed(1)} MB/s`;
}
function StatusLine() {
  const { mode, why, engine, errorBound, latencyMs, stream } = status.value;
  if (mode === "none") return null;
  return (
    <footer class="status">
      {why && <span class="why">{why}</span>}
      <span title="Engine that computes the light">{engine}</span>
      {errorBound > 0 && (
        <span title="Relative RMSE against the reference, as the bake measured it">
          error {(100 * errorBound).toFixed(errorBound < 0.01 ? 2 : 1)} %
        </span>
      )}
      <span title="How the light comes">{stream}</span>
      <span title="From the hand to the newest light">{Math.round(latencyMs)} ms</span>
      <span title="Bytes received">{rate(bytesPerSecond.value)}</span>
    </footer>
  );
}

function Empty() {
  if (
    connection.value.is !== "ready" ||
    models.value === null ||
    scene.value.model ||
    busy.value
  )
    return null;
  return (
    <div class="empty">
      <h1>Turn the light over a model</h1>
      <p>
        {mayUpload.value
          ? "Drop a model here: GLB, OBJ, PLY or STL. It is seen at once, and baked while you look."
          : "There is no model yet, and this token may not bring one."}
      </p>
      {mayUpload.value && (
        <label class="file-button primary">
          <Icon name="plus" /> Choose a file
          <FileInput accept=".glb,.gltf,.obj,.ply,.stl" />
        </label>
      )}
    </div>
  );
}

const hasFiles = (event: DragEvent) => event.dataTransfer?.types.includes("Files") ?? false;

function useDrops(over: { value: boolean }): void {
  useEffect(() => {
    const stop = new AbortController();
    const { signal } = stop;
    addEventListener(
      "dragover",
      (event) => {
        if (!hasFiles(event)) return; // words go into fields
        event.preventDefault();
        over.value = true;
      },
      { signal },
    );
    addEventListener("dragleave", (event) => (over.value = event.relatedTarget !== null), {
      signal,
    });
    addEventListener(
      "drop",
      (event) => {
        if (!hasFiles(event)) return;
        event.preventDefault();
        over.value = false;
        if (mayUpload.value) void takeFiles(event.dataTransfer?.files ?? []);
        else fault(new PageError("This token may not upload (scope upload)."));
      },
      { signal },
    );
    addEventListener(
      "keydown",
      (event) => {
        if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "z") return;
        if (event.target instanceof HTMLInputElement && event.target.type !== "range") return;
        if (event.target instanceof HTMLTextAreaElement || covered.value) return;
        event.preventDefault();
        if (event.shiftKey) redo();
        else undo();
      },
      { signal },
    );
    return () => stop.abort();
  }, []);
}

const REDUCED = matchMedia("(prefers-reduced-motion: reduce)");
/** Turns the camera slowly until a hand stops it. */
function useTurntable(on: boolean): void {
  useEffect(() => {
    if (!on) return undefined;
    let last = performance.now();
    let frame = 0;
    const turn = (now: number) => {
      const { orbit } = scene.value;
      setOrbit({ ...orbit, azimuth: orbit.azimuth + (now - last) * 0.018 });
      last = now;
      frame = requestAnimationFrame(turn);
    };
    frame = requestAnimationFrame(turn);
    return () => cancelAnimationFrame(frame);
  }, [on]);
}

export function App() {
  const drawer = useSignal<"models" | "rooms" | null>(null); // the list that is open
  const over = useSignal(false);
  const turning = useSignal(false);
  const copied = useSignal(false);
  useDrops(over);
  useTurntable(turning.value);
  const inRoom = room.value !== null;
  useEffect(() => {
    if (inRoom) tab.value = "review";
    else if (tab.value === "review") tab.value = "light"; // that tab is of rooms
  }, [inRoom]);
  const tabs = inRoom ? [REVIEW, ...TABS] : TABS;
  const Panel = tabs.find((one) => one.id === tab.value)?.panel ?? LightPanel;
  const name = info.value?.name || info.value?.model.slice(0, 12) || "Choose a model";
  const close = () => (drawer.value = null);
  const toggle = (list: "models" | "rooms") =>
    (drawer.value = drawer.value === list ? null : list);
  const share = () => {
    void copyLink(linkNow()).then((done) => {
      copied.value = done;
      setTimeout(() => (copied.value = false), 1600);
    });
  };
  return (
    <div class="app">
      <header class="top" inert={covered.value}>
        <span class="brand">
          <img src="/favicon.svg" alt="" width={22} height={22} />
          Relight
        </span>
        <button
          type="button"
          class="model-button"
          aria-expanded={drawer.value === "models"}
          onClick={() => toggle("models")}
        >
          <Icon name="models" /> <span>{name}</span>
        </button>
        <RoomsButton open={drawer.value === "rooms"} onClick={() => toggle("rooms")} />
        <span class="gap" />
        <IconButton
          icon="undo"
          label="Undo (Ctrl+Z)"
          disabled={!canUndo.value}
          onClick={undo}
        />
        <IconButton
          icon="redo"
          label="Redo (Ctrl+Shift+Z)"
          disabled={!canRedo.value}
          onClick={redo}
        />
        <IconButton
          icon="spin"
          label={REDUCED.matches ? "Turntable (your system asks for less motion)" : "Turntable"}
          pressed={turning.value}
          onClick={() => (turning.value = !turning.value)}
        />
        <IconButton
          icon="share"
          label={copied.value ? "The link is copied" : "Copy a link to this picture"}
          onClick={share}
        />
      </header>
      <main inert={covered.value} onPointerDownCapture={() => (turning.value = false)}>
        <StageView />
        {inRoom && <Pins />}
        <RoomBar />
        <Empty />
        <div class="overlay">
          <Notice />
          <LinkToCopy />
          <Work />
        </div>
        <StatusLine />
        {over.value && <div class="drop">Drop a model or a light</div>}
        {copied.value && (
          <div class="toast" role="status">
            The link is copied
          </div>
        )}
      </main>
      <PrintView />
      {inRoom && <RevisionCompare />}
      {drawer.value === "rooms" && !covered.value && <Rooms close={close} />}
      {drawer.value === "models" && !covered.value && <Models close={close} />}
      <aside class="panel" aria-label="Settings" inert={covered.value}>
        <div class="tabs" role="tablist" aria-label="Settings" onKeyDown={arrowKeys}>
          {tabs.map((one) => (
            <button
              key={one.id}
              id={`tab-${one.id}`}
              type="button"
              role="tab"
              aria-selected={one.id === tab.value}
              aria-controls="tab-panel"
              onClick={() => (tab.value = one.id)}
            >
              {one.label}
            </button>
          ))}
        </div>
        <div
          id="tab-panel"
          class="tab-panel"
          role="tabpanel"
          aria-labelledby={`tab-${tab.value}`}
          tabIndex={0}
        >
          <Panel />
        </div>
      </aside>
    </div>
  );
}
