// node three_check.mjs FILE.glb EXPECTED.json
// EXPECTED: {"times": [s], "nodes": [glTF node], "positions": [time][node][x, y, z] in scene units,
// "tolerance": m}. Plays the file's one animation with three.js and compares where the nodes are.
// three renames nodes, so they are found by parser.associations.
import fs from 'node:fs';
import { importFrom } from './node_modules.mjs';

const three = await importFrom('three', 'build/three.module.js');
const { GLTFLoader } = await importFrom('three', 'examples/jsm/loaders/GLTFLoader.js');

// Pictures need a browser and do not move anything.
function withoutPictures(glb) {
  const length = glb.readUInt32LE(12);
  const json = JSON.parse(glb.subarray(20, 20 + length).toString('utf8'));
  for (const key of ['images', 'textures', 'materials', 'samplers', 'extensions']) delete json[key];
  delete json.extensionsRequired;
  for (const mesh of json.meshes ?? []) {
    for (const primitive of mesh.primitives) {
      delete primitive.material;
      delete primitive.extensions;
    }
  }
  let text = Buffer.from(JSON.stringify(json), 'utf8');
  text = Buffer.concat([text, Buffer.alloc((4 - (text.length % 4)) % 4, 0x20)]);
  const rest = glb.subarray(20 + length);
  const head = Buffer.from(glb.subarray(0, 20));
  head.writeUInt32LE(20 + text.length + rest.length, 8);
  head.writeUInt32LE(text.length, 12);
  const out = Buffer.concat([head, text, rest]);
  return out.buffer.slice(out.byteOffset, out.byteOffset + out.byteLength);
}

const [file, expectedFile] = process.argv.slice(2);
const expected = JSON.parse(fs.readFileSync(expectedFile, 'utf8'));
globalThis.self ??= globalThis;
const gltf = await new GLTFLoader().parseAsync(withoutPictures(fs.readFileSync(file)), '');
if (gltf.animations.length !== 1) {
  console.log(`${gltf.animations.length} animations instead of one`);
  process.exit(1);
}

const objectOfNode = new Map();
for (const [object, where] of gltf.parser.associations) {
  if (object.isObject3D && where.nodes !== undefined) objectOfNode.set(where.nodes, object);
}

const mixer = new three.AnimationMixer(gltf.scene);
const action = mixer.clipAction(gltf.animations[0]);
action.setLoop(three.LoopOnce);
action.clampWhenFinished = true;
action.play();
let worst = 0;
let compared = 0;
let where = '';
expected.times.forEach((time, t) => {
  mixer.setTime(time);
  gltf.scene.updateMatrixWorld(true);
  expected.nodes.forEach((node, n) => {
    const object = objectOfNode.get(node);
    if (object === undefined) return; // outside the scene: three.js never makes it
    const is = new three.Vector3().setFromMatrixPosition(object.matrixWorld);
    const error = is.distanceTo(new three.Vector3(...expected.positions[t][n]));
    ++compared;
    if (!(error <= worst)) {
      worst = error;
      where = `node ${node} (${object.name}) at ${time} s`;
    }
  });
});
console.log(`${compared} places compared, worst ${worst} ${where}`);
process.exit(worst <= expected.tolerance && compared > 0 ? 0 : 1);
