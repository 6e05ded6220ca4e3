// SPDX-License-Identifier: MIT
// Writes src/gen: relight_pb.ts, proto/relight.proto in TypeScript, by protoc and protoc-gen-es; and
// presets.ts, the media of libprt/medium/material.c.
import { execFileSync } from "node:child_process";
import { existsSync, mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const web = join(dirname(fileURLToPath(import.meta.url)), "..");
const proto = join(web, "..", "..", "proto");
const out = join(web, "src", "gen");
// Not what npm puts first on PATH: a package could bring a protoc that downloads another.
const protoc = ["/usr/bin/protoc", "/usr/local/bin/protoc"].find(existsSync) ?? "protoc";

mkdirSync(out, { recursive: true });
try {
  execFileSync(
    protoc,
    [
      `--plugin=protoc-gen-es=${join(web, "node_modules", ".bin", "protoc-gen-es")}`,
      `--proto_path=${proto}`,
      `--es_out=${out}`,
      "--es_opt=target=ts",
      "relight.proto",
    ],
    { stdio: "inherit" },
  );
} catch (error) {
  console.error(
    `error: ${protoc} failed (${error.code ?? error.message}); deploy/dependencies --page installs it`,
  );
  process.exit(1);
}

const source = readFileSync(join(web, "..", "..", "libprt", "medium", "material.c"), "utf8");
const numbers = (texts) => texts.map((text) => Number(text.replace(/f$/, "")));
const presets = [...source.matchAll(/^ *MEDIUM\("(\w+)", ([^)]*)\)/gm)].map(
  ([, name, values]) => {
    const [sr, sg, sb, ar, ag, ab, eta] = numbers(values.split(/,\s*/));
    return { name, sigmaSPrime: [sr, sg, sb], sigmaA: [ar, ag, ab], eta, roughness: 0.3 };
  },
);
if (!presets.length || presets.some((preset) => !Number.isFinite(preset.eta))) {
  console.error("error: libprt/medium/material.c has no presets in the form that is read here");
  process.exit(1);
}
writeFileSync(
  join(out, "presets.ts"),
  `// Generated from libprt/medium/material.c by scripts/generate.mjs.
type Rgb = [number, number, number];
export interface Preset {
  name: string;
  sigmaSPrime: Rgb;
  sigmaA: Rgb;
  eta: number;
  roughness: number;
}
export const PRESETS: readonly Preset[] = ${JSON.stringify(presets)};
`,
);
