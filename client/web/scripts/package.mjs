// SPDX-License-Identifier: MIT
// Builds the npm package relight-viewer into a folder: npm run package [-- --out DIR] (package
// without it). `npm pack DIR` makes the archive.
import { build } from "esbuild";
import { execFileSync } from "node:child_process";
import { copyFileSync, mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const web = join(dirname(fileURLToPath(import.meta.url)), "..");
const at = process.argv.indexOf("--out");
const out = at > 0 ? process.argv[at + 1] : join(web, "package");
const own = JSON.parse(readFileSync(join(web, "package.json"), "utf8"));

rmSync(out, { recursive: true, force: true });
mkdirSync(out, { recursive: true });
await build({
  absWorkingDir: web,
  entryPoints: { "relight-viewer": "src/element/viewer.ts", client: "src/client.ts" },
  outdir: join(out, "dist"),
  chunkNames: "[name]-[hash]",
  bundle: true,
  splitting: true,
  format: "esm",
  target: ["es2022"],
  minify: true,
  legalComments: "linked",
  logLevel: "warning",
});
execFileSync(
  join(web, "node_modules/.bin/tsc"),
  [
    ...["--declaration", "--emitDeclarationOnly", "--noEmit", "false"],
    ...["--outDir", join(out, "types"), "--rootDir", join(web, "src")],
    ...["--target", "ES2022", "--module", "ESNext", "--moduleResolution", "Bundler"],
    ...["--lib", "ES2022,DOM,DOM.Iterable", "--strict", "--skipLibCheck", "--types", "node"],
    ...[join(web, "src/element/viewer.ts"), join(web, "src/client.ts")],
  ],
  { cwd: web, stdio: "inherit" },
);
writeFileSync(
  join(out, "package.json"),
  `${JSON.stringify(
    {
      name: "relight-viewer",
      version: own.version,
      description: "<relight-viewer> and a client of relightd, which lights translucent models",
      license: own.license,
      type: "module",
      exports: {
        ".": { types: "./types/element/viewer.d.ts", default: "./dist/relight-viewer.js" },
        "./client": { types: "./types/client.d.ts", default: "./dist/client.js" },
      },
      types: "./types/element/viewer.d.ts",
      sideEffects: ["./dist/relight-viewer.js"],
      files: ["dist", "types", "README.md", "LICENSE", "examples"],
      // What the types name; the code is bundled.
      dependencies: {
        "@bufbuild/protobuf": own.dependencies["@bufbuild/protobuf"],
        "@types/three": own.devDependencies["@types/three"],
      },
    },
    null,
    2,
  )}\n`,
);
copyFileSync(join(web, "package.md"), join(out, "README.md"));
copyFileSync(join(web, "../../LICENSE"), join(out, "LICENSE"));
mkdirSync(join(out, "examples"));
for (const file of ["embed.html", "client.html"])
  copyFileSync(join(web, "examples", file), join(out, "examples", file));
console.log(`package: relight-viewer ${own.version} is in ${out}`);
