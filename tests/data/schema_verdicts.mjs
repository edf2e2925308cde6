// node schema_verdicts.mjs SCHEMA DOCUMENTS OUT: a verdict of ajv for each document of an array.
import fs from 'node:fs';
import { createRequire } from 'node:module';
import path from 'node:path';

const [schemaFile, documentsFile, out] = process.argv.slice(2);
const folder = process.env.LIMBER_NODE_MODULES ?? path.resolve('node_modules');
const Ajv = createRequire(path.join(path.resolve(folder), 'here.js'))('ajv/dist/2020').default;

const ajv = new Ajv({
  allErrors: true, strictTypes: false, strictRequired: false, strictTuples: false,
  allowUnionTypes: true,
});
const validate = ajv.compile(JSON.parse(fs.readFileSync(schemaFile)));
const verdicts = JSON.parse(fs.readFileSync(documentsFile)).map((document) => ({
  valid: validate(document),
  errors: ajv.errorsText(validate.errors),
}));
fs.writeFileSync(out, JSON.stringify(verdicts));
