// SPDX-License-Identifier: MIT
// Builds the page into a folder: npm run build [-- --out DIR] (dist without it). Files under
// assets/ have names that change with their bytes; index.html and relight-viewer.js name them.
// Beside each file of text lie its gzip and brotli forms, which relightd sends.
import { build } from "esbuild";
import { mkdirSync, readFileSync, readdirSync, rmSync, statSync, writeFileSync } from "node:fs";
import { dirname, join, relative } from "node:path";
import { fileURLToPath } from "node:url";
import { brotliCompressSync, constants, gzipSync } from "node:zlib";

const web = join(dirname(fileURLToPath(import.meta.url)), "..");
const at = process.argv.indexOf("--out");
const out = at > 0 ? process.argv[at + 1] : join(web, "dist");
// Bytes of the first load, gzipped: index.html and all that it leads to.
const FIRST_LOAD = 250e3;

rmSync(out, { recursive: true, force: true });
mkdirSync(out, { recursive: true });
const result = await build({
  absWorkingDir: web,
  entryPoints: { page: "src/main.tsx", "relight-viewer": "src/element/viewer.ts" },
  outdir: join(out, "assets"),
  entryNames: "[name]-[hash]",
  chunkNames: "[name]-[hash]",
  bundle: true,
  splitting: true,
  format: "esm",
  target: ["es2022"],
  minify: true,
  sourcemap: false,
  legalComments: "none",
  metafile: true,
  jsx: "automatic",
  jsxImportSource: "preact",
  loader: { ".css": "css", ".svg": "text" },
  define: { "process.env.NODE_ENV": '"production"' },
  logLevel: "warning",
});

// The output of an entry point, as a URL below the page.
function outputOf(entry) {
  const [path, info] = Object.entries(result.metafile.outputs).find(
    ([, output]) => output.entryPoint === entry,
  );
  const url = (file) => relative(out, join(web, file));
  return { path, url: url(path), css: info.cssBundle && url(info.cssBundle) };
}
// Imported when it is wanted first, if ever.
const LATER = ["src/scene/still-surface.ts"];
// An entry and everything that it leads to: the stage, too, which it imports as soon as it runs.
function loaded(path, found = new Set()) {
  found.add(path);
  for (const { path: next } of result.metafile.outputs[path].imports)
    if (!found.has(next) && !LATER.includes(result.metafile.outputs[next].entryPoint))
      loaded(next, found);
  return found;
}

const page = outputOf("src/main.tsx");
const viewer = outputOf("src/element/viewer.ts");
const needed = loaded(page.path);
const preload = [...needed]
  .filter((path) => path !== page.path)
  .map((path) => `<link rel="modulepreload" href="/${relative(out, join(web, path))}" />`);
const html = readFileSync(join(web, "index.html"), "utf8")
  .replace("<!-- style -->", `<link rel="stylesheet" href="/${page.css}" />${preload.join("")}`)
  .replace("<!-- script -->", `<script type="module" src="/${page.url}"></script>`);
writeFileSync(join(out, "index.html"), html);
writeFileSync(join(out, "favicon.svg"), readFileSync(join(web, "favicon.svg")));
writeFileSync(join(out, "relight-viewer.js"), `export * from "./${viewer.url}";\n`);

function files(folder) {
  return readdirSync(folder, { withFileTypes: true }).flatMap((entry) =>
    entry.isDirectory() ? files(join(folder, entry.name)) : [join(folder, entry.name)],
  );
}
for (const file of files(out)) {
  const bytes = readFileSync(file);
  writeFileSync(`${file}.gz`, gzipSync(bytes, { level: 9 }));
  writeFileSync(
    `${file}.br`,
    brotliCompressSync(bytes, { params: { [constants.BROTLI_PARAM_QUALITY]: 11 } }),
  );
}
const first = [
  join(out, "index.html"),
  join(out, page.css),
  ...[...needed].map((p) => join(web, p)),
];
const size = first.reduce((sum, file) => sum + statSync(`${file}.gz`).size, 0);
console.log(
  `page: first load ${(size / 1e3).toFixed(1)} kB gzipped, of ${FIRST_LOAD / 1e3} allowed`,
);
if (size > FIRST_LOAD) {
  console.error(
    "error: the first load is too large; import what is not needed at once by import()",
  );
  process.exit(1);
}
