// node report_browser.mjs PAGE [SCREENSHOTS]: the page of a batch in headless Chromium, opened from
// the disk. Exit code 77, with the reason, where there is no Chromium or no playwright-core.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import fs from 'node:fs';
import { createRequire } from 'node:module';
import path from 'node:path';
import { pathToFileURL } from 'node:url';

const file = path.resolve(process.argv[2]);
const skip = (reason) => { console.log(`no browser test: ${reason}`); process.exit(77); };

function chromiumPath() {
  for (const name of [process.env.LIMBER_CHROMIUM, 'chromium', 'chromium-browser', 'google-chrome']) {
    if (!name) continue;
    try { return execFileSync('sh', ['-c', 'command -v "$0"', name], { encoding: 'utf8' }).trim(); } catch { /* next */ }
  }
  return skip('Chromium is not installed (Debian: chromium)');
}

function playwright() {
  const modules = path.resolve(process.env.LIMBER_NODE_MODULES ?? 'node_modules');
  try {
    return createRequire(path.join(modules, 'here.js'))('playwright-core');
  } catch {
    return skip(`playwright-core is not in ${modules} (LIMBER_NODE_MODULES)`);
  }
}

const executablePath = chromiumPath();
const browser = await playwright().chromium.launch({ executablePath });
const complaints = [], requests = [];
const context = await browser.newContext({ viewport: { width: 1400, height: 900 } });
const page = await context.newPage();
page.on('console', (m) => { if (m.type() !== 'log') complaints.push(m.text()); });
page.on('pageerror', (e) => complaints.push(e.message));
page.on('request', (r) => requests.push(r.url()));

const folder = path.dirname(file);
const reports = fs.readdirSync(folder).filter((name) => name.endsWith('.report.json'))
  .map((name) => ({ name: name.slice(0, -12), ...JSON.parse(fs.readFileSync(path.join(folder, name), 'utf8')) }));
const cards = page.locator('.card');
const count = () => page.locator('#count').textContent();
/** Waits until the page says how many clips a filter left. */
async function leaves(wanted, why) {
  const all = reports.length, text = wanted === all ? `${all} clips` : `${wanted} of ${all} clips`;
  await page.waitForFunction((t) => document.getElementById('count').textContent === t, text, { timeout: 30000 })
    .catch(async () => assert.fail(`${why}: "${await count()}", not "${text}"`));
}
const reset = () => page.click('#reset');

await page.goto(pathToFileURL(file).href);
await cards.first().waitFor();
await leaves(reports.length, 'no filter');

// Worst first: the verdicts never get better and then worse again, down the whole gallery.
while ((await cards.count()) < reports.length) {
  const before = await cards.count();
  await page.locator('#sentinel').scrollIntoViewIfNeeded();
  await page.waitForFunction((n) => document.querySelectorAll('.card').length > n, before);
}
const order = await page.$$eval('.card .badge', (badges) => badges.map((b) => b.textContent));
const rank = { fail: 0, warn: 1, pass: 2 };
assert.deepEqual(order, [...order].sort((a, b) => rank[a] - rank[b]), 'worst first');
for (const status of Object.keys(rank)) {
  const wanted = reports.filter((r) => r.status === status).length;
  assert.equal(order.filter((s) => s === status).length, wanted, status);
  await page.click(`.verdict.${status}`);
  await leaves(wanted, `filter ${status}`);
  await page.click(`.verdict.${status}`);
}

await page.selectOption('#target', 'hand');
await leaves(reports.filter((r) => r.name.endsWith('@hand')).length, 'filter by target');
await reset();
await page.fill('#source', 'take3');
await leaves(reports.filter((r) => r.source.path.includes('take3')).length, 'filter by source');
await reset();
await page.selectOption('#finding', 'feet-slide');
await leaves(reports.filter((r) => r.warnings.some((w) => w.code === 'feet-slide')).length, 'filter by finding');
await reset();
const error = (r) => Math.max(...r.effectors.map((e) => e.position_error_mm.p95));
await page.selectOption('#metric', { label: 'Effector error, p95' });
await page.fill('#value', '100');
await leaves(reports.filter((r) => error(r) >= 100).length, 'filter by metric');
await page.selectOption('#sense', 'le');
await leaves(reports.filter((r) => error(r) <= 100).length, 'filter by metric, at most');

// A view is in its address: opened anew it is the same.
const there = await page.evaluate(() => location.hash);
assert.match(there, /value=100/);
await reset();
await leaves(reports.length, 'reset');
await page.keyboard.press('Escape');
await page.locator('h1').click();
await page.keyboard.press('/');
await page.keyboard.type('take33@hand');
await leaves(1, 'search by keyboard');

// One clip: by keyboard in, through and out, and the focus comes back.
await reset();
await page.selectOption('#sort', 'name');
await page.waitForFunction(() => document.querySelector('.card .name bdi').textContent.startsWith('0'));
await cards.nth(0).focus();
await page.keyboard.press('ArrowRight');
const name = await page.evaluate(() => document.activeElement.querySelector('.name bdi').textContent);
await page.keyboard.press('Enter');
const title = page.locator('#detail-name');
await title.waitFor();
assert.equal(await title.textContent(), name);
await page.keyboard.press('ArrowRight');
assert.notEqual(await title.textContent(), name);
await page.keyboard.press('ArrowLeft');
assert.equal(await title.textContent(), name);
await page.keyboard.press('Escape');
assert.equal(await page.locator('#detail').isVisible(), false);
assert.equal(await page.evaluate(() => document.activeElement.querySelector('.name bdi').textContent), name);

// Plots, figures and findings are there.
await page.fill('#text', 'take30@hero');
await leaves(1, 'search');
await cards.first().click();
for (const part of ['.plot-error path.line', '.contacts rect.stand', '.figures', '.findings li']) {
  assert.ok(await page.locator(`#detail ${part}`).count() > 0, part);
}
await page.keyboard.press('Escape');
await reset();

// Every joint that a report names has its histogram.
await page.click('#tab-joints');
const joints = new Set(reports.flatMap((r) => r.limits.at_limit.map((j) => j.joint.slice(0, 200))));
assert.equal(await page.locator('.joints tbody tr').count(), joints.size);
assert.ok(await page.locator('.joints .shares .c').count() >= 11 * joints.size);
await page.click('#tab-clips');

// Hostile names in every clip opened, one after the other: nothing ran, nothing became markup.
const hostile = await page.evaluate(() => batch.clips.filter((c) => /^\d/.test(c.name)).map((c) => c.base));
assert.ok(hostile.length > 0);
for (const base of hostile) {
  await page.evaluate((clip) => { location.hash = `clip=${encodeURIComponent(clip)}`; }, base);
  await page.locator('#detail[open]').waitFor({ timeout: 30000 });
  await page.keyboard.press('Escape');
  // Closing takes the clip out of the address in a task of its own, which must not meet the next one.
  await page.waitForFunction(() => !location.hash.includes('clip='));
}
assert.equal(await page.evaluate(() => window.owned), undefined);
assert.equal(await page.locator('script').count(), 2, 'the batch and the script; the clips were taken');
assert.equal(await page.locator('img[src="x"], img[onerror]').count(), 0);
const hidden = await page.evaluate(() => /[\u0000-\u0008\u000b-\u001f\u202a-\u202e\u2066-\u2069]/.test(document.body.innerText));
assert.equal(hidden, false, 'a control character reached the page');

// A phone: nothing wider than the screen.
await page.setViewportSize({ width: 390, height: 844 });
assert.ok(await page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), 'fits a phone');

const foreign = requests.filter((url) => !url.startsWith('file:') && !url.startsWith('data:'));
assert.deepEqual(foreign, [], 'requests that leave the disk');
// A sheet that is no picture, or is gone, is no fault of the page.
assert.deepEqual(complaints.filter((text) => !text.includes('ERR_FILE_NOT_FOUND')), []);
await browser.close();
console.log(`report_browser: ${reports.length} clips, ${requests.length} requests, none of which left the disk`);
