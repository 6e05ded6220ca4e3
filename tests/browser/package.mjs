// SPDX-License-Identifier: MIT
// The npm package relight-viewer: what npm would pack, that its types hold in another program,
// and that a type error there is one. Argument: the folder of client/web.
import { execFileSync, spawnSync } from "node:child_process";
import {
  existsSync,
  mkdirSync,
  mkdtempSync,
  rmSync,
  symlinkSync,
  writeFileSync,
} from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import assert from "node:assert/strict";

const [web] = process.argv.slice(2);
const folder = mkdtempSync(join(tmpdir(), "relight-package-"));
const built = join(folder, "package");

function packed() {
  const text = execFileSync("npm", ["pack", "--dry-run", "--json", "--ignore-scripts"], {
    cwd: built,
    stdio: ["ignore", "pipe", "ignore"],
  });
  return JSON.parse(String(text))[0];
}

// A program that depends on the package: strict, with isolated modules.
function compiles(source) {
  const program = join(folder, "program");
  rmSync(program, { recursive: true, force: true });
  mkdirSync(join(program, "node_modules"), { recursive: true });
  symlinkSync(built, join(program, "node_modules/relight-viewer"));
  for (const name of ["@bufbuild", "@types"])
    symlinkSync(join(web, "node_modules", name), join(program, "node_modules", name));
  for (const name of ["@bufbuild", "@types"])
    if (!existsSync(join(built, "node_modules", name))) {
      mkdirSync(join(built, "node_modules"), { recursive: true });
      symlinkSync(join(web, "node_modules", name), join(built, "node_modules", name));
    }
  writeFileSync(join(program, "main.ts"), source);
  const options =
    "--noEmit --strict --isolatedModules --skipLibCheck --target ES2022 --module ESNext";
  return spawnSync(
    join(web, "node_modules/.bin/tsc"),
    [...options.split(" "), "--moduleResolution", "Bundler", "--types", "node", "main.ts"],
    { cwd: program },
  );
}

try {
  const said = execFileSync(
    process.execPath,
    [join(web, "scripts/package.mjs"), "--out", built],
    { stdio: ["inherit", "pipe", "inherit"] },
  );
  assert.ok(String(said).includes(built), "it says where the package is");
  const pack = packed();
  const names = pack.files.map(({ path }) => path);
  for (const wanted of [
    ...["LICENSE", "README.md", "package.json", "examples/embed.html", "examples/client.html"],
    ...["dist/relight-viewer.js", "dist/client.js"],
    ...["types/element/viewer.d.ts", "types/client.d.ts", "types/gen/relight_pb.d.ts"],
  ])
    assert.ok(names.includes(wanted), `${wanted} is not in the package`);
  assert.ok(names.every((name) => !/\.(ts|map)$/.test(name) || name.endsWith(".d.ts")));
  assert.ok(pack.size < 400e3, `the package has ${pack.size} bytes`);
  const good = compiles(`
    import "relight-viewer";
    import { Client, ColorsAnswerSchema, ColorsRequestSchema, Type, floats } from "relight-viewer/client";
    const one = document.createElement("relight-viewer");
    one.turnLight(30);
    const azimuth: number = one.cameraOrbit.azimuth;
    const client = new Client("ws://host/ws");
    export async function mean(): Promise<number> {
      const { message, payload } = await client.request(
        Type.Colors, ColorsRequestSchema, { model: "bunny" }, ColorsAnswerSchema);
      return floats(payload, 0, 3 * message.nVertex).length + azimuth;
    }`);
  assert.equal(good.status, 0, String(good.stdout));
  const bad = compiles(`
    import { Client, ColorsAnswerSchema, ColorsRequestSchema, Type } from "relight-viewer/client";
    void new Client("ws://host/ws").request(
      Type.Colors, ColorsRequestSchema, { model: 7 }, ColorsAnswerSchema);`);
  assert.notEqual(bad.status, 0);
  assert.match(String(bad.stdout), /main\.ts.*'number' is not assignable to type 'string'/);
  console.log(`ok   ${names.length} files, ${(pack.size / 1e3).toFixed(0)} kB packed`);
} finally {
  rmSync(folder, { recursive: true, force: true });
}
