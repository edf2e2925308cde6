// node report_clips.mjs: how the page of a batch orders, filters and counts, without a browser.
import assert from 'node:assert/strict';
import fs from 'node:fs';
import path from 'node:path';
import { fileURLToPath } from 'node:url';
import vm from 'node:vm';

const root = path.resolve(path.dirname(fileURLToPath(import.meta.url)), '../..');
const source = fs.readFileSync(path.join(root, 'assets/data/report/clips.js'), 'utf8');
const page = {};
vm.runInNewContext(`${source}
Object.assign(page, { readBatch, selectClips, jointTable, plain, decodeLine, figure, tally });`, { page });
const same = (a, b) => assert.deepEqual(JSON.parse(JSON.stringify(a)), b);

const metrics = [{ label: 'error', level: 100 }, { label: 'gap', level: 5 }, { label: 'length', level: 0 }];
const names = ['hero', 'hand', 'feet-slide', 'bvh-nan', 'knee', 'neck'];
const row = (name, status, values, more = {}) =>
  ({ base: name, name, source: `in/${name}.bvh`, target: 0, status, frames: 100, findings: [], metrics: values, ...more });
const rows = [
  row('calm', 0, [10, 1, 9]),
  row('long', 0, [10, 1, 90]),
  row('gappy', 1, [10, 20, 9], { findings: [[2, 0, 'feet slide 3 cm/s', -1, -1]] }),
  row('far', 1, [300, 0, 9]),
  row('broken', 2, [null, null, null], { frames: 0, target: 1, findings: [[3, 1, 'not finite', 4, 7]] }),
  row('violating', 2, [120, 0, 9]),
];
const batch = page.readBatch(rows, { names, metrics, codes: {}, folder: 'f', version: '1', excess_edges_deg: [2] });
const all = { text: '', source: '', target: '', finding: '', metric: '', sense: 'ge', value: '', sort: 'worst', statuses: [] };
const shown = (filter) => Array.from(page.selectClips(batch.clips, { ...all, ...filter }), (c) => c.name);

// Verdict first; then no result at all; then the metric furthest above its level: gap 20 of 5 is
// worse than error 300 of 100, and a metric without a level blames nobody.
same(shown({}), ['broken', 'violating', 'gappy', 'far', 'calm', 'long']);
same(shown({ sort: 'name' }), ['broken', 'calm', 'far', 'gappy', 'long', 'violating']);
same(shown({ sort: '2' })[0], 'long');
same(shown({ sort: '0' }).at(-1), 'broken');

same(shown({ statuses: ['warn'] }), ['gappy', 'far']);
same(shown({ statuses: ['pass', 'fail'] }), ['broken', 'violating', 'calm', 'long']);
same(shown({ target: 'hand' }), ['broken']);
same(shown({ source: 'IN/GAP' }), ['gappy']);
same(shown({ finding: 'bvh-nan' }), ['broken']);
same(shown({ metric: '0', value: '120' }), ['violating', 'far']);
same(shown({ metric: '0', sense: 'le', value: '10' }), ['gappy', 'calm', 'long']);
same(shown({ metric: '0', value: '' }).length, 6);
same(shown({ text: 'slide CM/s' }), ['gappy']);
same(shown({ text: 'knee hand' }), ['broken']);
same(shown({ text: 'knee hero' }), []);
same(shown({ text: 'nothing such' }), []);

// Three clips on one target: the knee stands on its limit 0, 21 and 100 frames of 100; the neck is
// asked beyond its limit in 40 frames of the last.
const limited = [
  row('a', 0, [0, 0, 0], { limits: [], bent: [] }),
  row('b', 0, [0, 0, 0], { limits: [[4, 21]], bent: [] }),
  row('c', 0, [0, 0, 0], { limits: [[4, 100]], bent: [[5, 40, 12.5, [10, 30]]] }),
  row('unchecked', 0, [0, 0, 0]),
];
const joints = page.readBatch(limited, { names, metrics, codes: {}, folder: 'f', version: '1', excess_edges_deg: [2] });
const table = page.jointTable(joints.clips, joints.jointsOfTarget);
const [knee, neck] = [table.find((r) => r.joint === 'knee'), table.find((r) => r.joint === 'neck')];
same([knee.clips, knee.frames, knee.atLimit], [3, 300, 121]);
same(knee.shares, [1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1]);
same([neck.beyond, neck.max, neck.worst.name, neck.classes], [40, 12.5, 'c', [10, 30]]);
same(neck.shares[0], 3);

assert.equal(page.plain('a\u001b[31mb\u202ec\u0000'), 'a\u241b[31mb\u2039U+202E\u203ac\u2400');
same(page.decodeLine([63, 'AB_']).values, [0, 1, 63]);
same(page.tally(['b', 'a', 'b', 'c']), [['b', 2], ['a', 1], ['c', 1]]);
same([0, 0.001, 0.5, 12.34, 250.4, 12345, null].map(page.figure), ['0', '<0.01', '0.50', '12.3', '250', '12,345', '\u2013']);
console.log('report_clips: orders, filters and counts hold');
