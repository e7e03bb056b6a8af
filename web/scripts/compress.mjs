// Lays a gzip file beside every file of the build, so that a node never compresses, and says what a visitor loads.
import { readdirSync, readFileSync, statSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { gzipSync } from "node:zlib";

function* files(folder) {
  for (const name of readdirSync(folder)) {
    const path = join(folder, name);
    if (statSync(path).isDirectory()) yield* files(path);
    else if (/\.(html|js|css|svg)$/.test(name)) yield path;
  }
}

let total = 0;
for (const path of files("dist")) {
  // The same bytes for the same source: no time of day in the file.
  const packed = gzipSync(readFileSync(path), { level: 9 });
  writeFileSync(`${path}.gz`, packed);
  total += packed.length;
}
console.log(`both pages together: ${(total / 1000).toFixed(1)} kB gzipped`);
