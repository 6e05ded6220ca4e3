// SPDX-License-Identifier: MIT
// The models of the daemon, with pictures, and the way to bring another.
import { useSignal, type Signal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { ModelState, type ModelInfo } from "../gen/relight_pb";
import { modelPicture } from "../scene/thumbnails";
import { PRESET_NAMES } from "../state/material";
import { START } from "../scene/camera";
import { Drawer, Icon } from "./controls";
import { FileInput } from "./file-input";
import {
  client,
  info,
  mayUpload,
  models,
  openFile,
  scene,
  set,
  unloadedFiles,
  uploadFlipV,
  uploadMaterial,
  uploadSizeMm,
  uploadUpZ,
  wordOf,
} from "./store";

const pictures = new Map<string, Promise<string>>();
function Picture({ model }: { model: ModelInfo }) {
  const source = useSignal("");
  useEffect(() => {
    const key = `${model.model}/${model.state}`;
    let picture = pictures.get(key);
    if (!picture) {
      picture = modelPicture(client, model.model);
      pictures.set(key, picture);
      picture.catch(() => pictures.delete(key));
    }
    picture.then((url) => (source.value = url)).catch(() => undefined);
  }, [model.model, model.state]);
  return source.value ? <img src={source.value} alt="" /> : <span class="no-picture" />;
}

const STATES: Partial<Record<ModelState, string>> = {
  [ModelState.MODEL_RECEIVED]: "being read",
  [ModelState.MODEL_PREVIEW]: "preview",
  [ModelState.MODEL_BAKING]: "baking",
  [ModelState.MODEL_UNLOADED]: "on disk",
  [ModelState.MODEL_FAILED]: "bake failed",
};
function facts(model: ModelInfo): string {
  const size = model.nVertex ? `${model.nVertex.toLocaleString("en")} vertices` : "";
  const error = model.errorBound ? `error ${(100 * model.errorBound).toFixed(2)} %` : "";
  return [STATES[model.state], size, error].filter(Boolean).join(" · ");
}

export function Models({ close }: { close: () => void }) {
  const all = models.value ?? [];
  const shown = info.value?.model;
  const unloaded = unloadedFiles.value;
  return (
    <Drawer title="Models" closeLabel="Close the list of models" close={close}>
      <ul class="models">
        {all.map((model) => (
          <li key={model.model}>
            <button
              type="button"
              class="model"
              aria-current={model.model === shown}
              onClick={() => {
                set({
                  model: wordOf(model),
                  material: "",
                  materials: {},
                  variant: "",
                  orbit: START,
                });
                close();
              }}
            >
              <Picture model={model} />
              <span>
                <b>{model.name || model.model.slice(0, 12)}</b>
                <small>{facts(model)}</small>
              </span>
            </button>
          </li>
        ))}
        {unloaded.map((path) => (
          <li key={path}>
            <button
              type="button"
              class="model"
              onClick={() => {
                close();
                void openFile(path);
              }}
            >
              <span class="no-picture" />
              <span>
                <b>{path}</b>
                <small>not loaded</small>
              </span>
            </button>
          </li>
        ))}
        {models.value?.length === 0 && !unloaded.length && (
          <li class="hint">There is no model yet.</li>
        )}
      </ul>
      {mayUpload.value && (
        <div class="bring">
          <label class="file-button">
            <Icon name="plus" /> Bring a model
            <FileInput accept=".glb,.gltf,.obj,.ply,.stl" chosen={close} />
          </label>
          <UploadSettings />
        </div>
      )}
      {scene.value.model &&
        !all.some((model) => model.name === scene.value.model || model.model === shown) && (
          <p class="hint">The model of this link is not loaded here.</p>
        )}
    </Drawer>
  );
}

function Check(props: { on: Signal<boolean>; title: string; children: string }) {
  return (
    <label title={props.title}>
      <input
        type="checkbox"
        checked={props.on.value}
        onChange={(event) => (props.on.value = event.currentTarget.checked)}
      />
      {props.children}
    </label>
  );
}

/** Size, axes and medium that the next model is baked with. */
export function UploadSettings() {
  return (
    <div class="upload-settings">
      <label>
        Size
        <input
          type="number"
          min={0.1}
          step="any"
          value={uploadSizeMm.value}
          onChange={(event) => {
            const mm = Number(event.currentTarget.value);
            if (mm > 0) uploadSizeMm.value = mm;
            event.currentTarget.value = String(uploadSizeMm.value);
          }}
        />
        mm
      </label>
      <label>
        Medium
        <select
          value={uploadMaterial.value}
          onChange={(event) => (uploadMaterial.value = event.currentTarget.value)}
        >
          <option value="">open: edit it later</option>
          {PRESET_NAMES.map((name) => (
            <option key={name} value={name}>
              {name}
            </option>
          ))}
        </select>
      </label>
      <Check on={uploadUpZ} title="As scans and STL files often need">
        Its z axis points up
      </Check>
      <Check on={uploadFlipV} title="As a face on the neck needs">
        Its textures lie upside down
      </Check>
    </div>
  );
}
