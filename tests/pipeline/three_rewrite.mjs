// node three_rewrite.mjs IN.glb OUT.glb
// Reads a file with three.js and writes it again with its own exporter: a file that we did not
// write. Meshes go, a skeleton and its motion stay.
import fs from 'node:fs';
import { importFrom } from '../exporters/node_modules.mjs';

const three = await importFrom('three', 'build/three.module.js');
const { GLTFLoader } = await importFrom('three', 'examples/jsm/loaders/GLTFLoader.js');
const { GLTFExporter } = await importFrom('three', 'examples/jsm/exporters/GLTFExporter.js');

// What the exporter takes from a browser.
globalThis.self ??= globalThis;
globalThis.FileReader ??= class {
  readAsArrayBuffer(blob) {
    blob.arrayBuffer().then((buffer) => {
      this.result = buffer;
      this.onloadend();
    });
  }
};

const [from, to] = process.argv.slice(2);
const bytes = fs.readFileSync(from);
const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
const gltf = await new GLTFLoader().parseAsync(buffer, '');
const meshes = [];
gltf.scene.traverse((object) => object.isMesh && meshes.push(object));
meshes.forEach((mesh) => mesh.removeFromParent());
if (gltf.animations.length !== 1) throw new Error(`${gltf.animations.length} animations`);
// THREE_DROP_KEY=N: without the N-th key of every track.
const drop = Number(process.env.THREE_DROP_KEY ?? -1);
for (const track of gltf.animations[0].tracks) {
  if (drop < 0 || track.times.length <= drop) continue;
  const size = track.getValueSize();
  track.times = track.times.filter((_, key) => key !== drop);
  track.values = track.values.filter((_, k) => Math.floor(k / size) !== drop);
}
const written = await new GLTFExporter().parseAsync(gltf.scene, {
  binary: true,
  animations: gltf.animations,
});
fs.writeFileSync(to, Buffer.from(written));
console.log(`three.js ${three.REVISION} wrote ${written.byteLength} bytes`);
