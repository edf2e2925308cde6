// node validate_glb.mjs OUTPUT [INPUT]
// The Khronos validator's errors in OUTPUT that INPUT, the file it was made from, did not have.
// Published models break rules of their own, so errors are counted per code. Exit 1 where one is new.
import fs from 'node:fs';
import path from 'node:path';
import { require } from './node_modules.mjs';

const validator = require('gltf-validator');

async function errors(file) {
  const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)), {
    uri: path.basename(file),
    maxIssues: 0,
    externalResourceFunction: async (uri) =>
      new Uint8Array(fs.readFileSync(path.join(path.dirname(file), decodeURIComponent(uri)))),
  });
  return report.issues.messages.filter((m) => m.severity === 0);
}

const count = (messages) => {
  const byCode = new Map();
  for (const m of messages) byCode.set(m.code, (byCode.get(m.code) ?? 0) + 1);
  return byCode;
};

const [output, input] = process.argv.slice(2);
const found = await errors(output);
const known = count(input ? await errors(input) : []);
let failed = false;
for (const [code, n] of count(found)) {
  if (n <= (known.get(code) ?? 0)) continue;
  failed = true;
  const example = found.find((m) => m.code === code);
  console.log(`${code}: ${n} (before: ${known.get(code) ?? 0}), e.g. ${example.pointer}: ${example.message}`);
}
process.exit(failed ? 1 : 0);
