// SPDX-License-Identifier: MIT
// A viewer on two canvases of the page: with a stage where the browser has WebGL 2.
import { Viewer, type ViewerEvents } from "../scene/viewer";
import { client, fault, fine } from "./store";

function hasWebGL2(): boolean {
  if (new URLSearchParams(location.search).has("no-webgl")) return false;
  const context = document.createElement("canvas").getContext("webgl2");
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return context !== null;
}

export async function makeViewer(
  nodes: { canvas: HTMLCanvasElement; pictureCanvas: HTMLCanvasElement },
  events: Pick<ViewerEvents, "status" | "info">,
): Promise<Viewer> {
  const { Stage } = await import("../scene/stage");
  let stage: InstanceType<typeof Stage> | null = null;
  if (hasWebGL2()) {
    try {
      stage = new Stage(nodes.canvas);
    } catch {
      stage = null; // pictures of the daemon instead
    }
  }
  const source = Symbol("view");
  return new Viewer(client, nodes, stage, {
    ...events,
    fault: (error, again) => fault(error, source, again),
    fine: () => fine(source),
  });
}
