// Makes src/api/*.d.ts from api/*.json, the OpenAPI documents that a test of the program keeps current.
// `--check` writes nothing and fails when they differ.
import openapiTS, { astToString } from "openapi-typescript";
import { existsSync, readFileSync, writeFileSync } from "node:fs";

/**
 * Where a threshold is read and set, its value has the policy's name for it beside other fields. OpenAPI says so by allowing
 * further numbers; in TypeScript that would ask every field to be a number, so it is left out there.
 */
export function withoutFlattenedThresholds(schema) {
  if (Array.isArray(schema)) return schema.map(withoutFlattenedThresholds);
  if (schema === null || typeof schema !== "object") return schema;
  const copy = Object.fromEntries(Object.entries(schema).map(([key, value]) => [key, withoutFlattenedThresholds(value)]));
  // The names of the program's functions: they need not differ between modules, and nothing here asks for them.
  if (copy.responses) delete copy.operationId;
  if (copy.properties && copy.additionalProperties?.type === "number") delete copy.additionalProperties;
  if (Array.isArray(copy.allOf)) {
    copy.allOf = copy.allOf.filter((part) => part.properties || part.$ref || part.oneOf || !part.additionalProperties);
  }
  return copy;
}

export async function types(service) {
  const document = JSON.parse(readFileSync(`api/${service}.json`, "utf8"));
  const tree = await openapiTS(withoutFlattenedThresholds(document));
  return `// Made by \`npm run types\` from api/${service}.json. Do not edit.\n\n${astToString(tree)}`;
}

if (process.argv[1]?.endsWith("types.mjs")) {
  const check = process.argv.includes("--check");
  for (const service of ["node", "hub"]) {
    const path = `src/api/${service}.d.ts`;
    const made = await types(service);
    if (!check) writeFileSync(path, made);
    else if (!existsSync(path) || readFileSync(path, "utf8") !== made) {
      console.error(`${path} is not what api/${service}.json gives: run \`npm run types\``);
      process.exitCode = 1;
    }
  }
}
