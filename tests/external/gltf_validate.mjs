// Reports of the Khronos validator: gltf_validate.mjs VALIDATOR FILE.glb...
// Fails on any error or warning.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [validatorPath, ...files] = process.argv.slice(2);
const validator = createRequire(pathToFileURL(validatorPath + "/"))("gltf-validator");
let bad = 0;
for (const file of files) {
  const report = await validator.validateBytes(new Uint8Array(readFileSync(file)));
  const { numErrors, numWarnings, messages } = report.issues;
  const passes = numErrors === 0 && numWarnings === 0;
  console.log(`${passes ? "ok    " : "FAILED"} ${file}: ${numErrors} errors, ${numWarnings} warnings, extensions ${report.info.extensionsUsed ?? "none"}`);
  if (!passes) {
    bad += 1;
    console.log(JSON.stringify(messages, null, 1));
  }
}
process.exit(bad === 0 ? 0 : 1);
