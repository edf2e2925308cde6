'use strict';
// The page itself: what is shown, kept in the address behind '#', so that a view can be shared.

const $ = (id) => document.getElementById(id);
const PAGE = 60;  // cards added at a time: a gallery of ten thousand stays quick
const FIELDS = ['text', 'source', 'target', 'finding', 'metric', 'sense', 'value', 'sort'];
const DEFAULTS = { text: '', source: '', target: '', finding: '', metric: '', sense: 'ge', value: '', sort: 'worst' };

const batch = readBatch(JSON.parse($('clips-data').textContent), JSON.parse($('batch-data').textContent));
$('clips-data').remove();
const state = { ...DEFAULTS, statuses: [], view: 'clips', open: '' };
let shown = [], drawn = 0, jointOrder = 'time';

// ---- the address

function readAddress() {
  const fields = new URLSearchParams(location.hash.slice(1));
  for (const key of FIELDS) {
    $(key).value = fields.get(key) ?? DEFAULTS[key];
    state[key] = $(key).value || DEFAULTS[key];  // what a control does not offer is not asked for
    $(key).value = state[key];
  }
  state.statuses = (fields.get('status') || '').split(',').filter((s) => STATUSES.includes(s));
  state.view = fields.get('view') === 'joints' ? 'joints' : 'clips';
  state.open = fields.get('clip') || '';
}

function address(open = state.open) {
  const fields = new URLSearchParams();
  for (const key of FIELDS) if (state[key] !== DEFAULTS[key]) fields.set(key, state[key]);
  if (state.statuses.length) fields.set('status', state.statuses.join(','));
  if (state.view !== 'clips') fields.set('view', state.view);
  if (open) fields.set('clip', open);
  return `#${fields}`;
}

const writeAddress = () => history.replaceState(null, '', address());

// ---- what stays the same

function option(value, text) {
  return make('option', { value, text });
}

function fillTop() {
  const seconds = batch.clips.reduce((sum, clip) => sum + clip.seconds, 0);
  const length = seconds >= 3600 ? `${figure(seconds / 3600)} hours` : seconds >= 60 ? `${figure(seconds / 60)} minutes` : `${figure(seconds)} seconds`;
  $('title').textContent = batch.folder || 'Limber report';
  document.title = `${batch.folder} \u2013 Limber report`;
  $('subtitle').textContent = `${batch.clips.length.toLocaleString('en-US')} clips, ${length} of motion, Limber ${batch.version}`;
  for (const [i, status] of STATUSES.entries()) {
    const count = batch.clips.filter((clip) => clip.status === i).length;
    $('verdicts').prepend(make('button', { type: 'button', class: `verdict ${status}`, 'data-status': status, 'aria-pressed': 'false',
      onclick: () => toggleStatus(status) },
      make('strong', { text: count.toLocaleString('en-US') }), make('span', { text: ` ${status}` })));
    const part = make('span', { class: status });
    part.style.flexGrow = count;
    $('share').prepend(part);
  }
  const findings = tally(batch.clips.flatMap((clip) => [...new Set(clip.findings.map((f) => f.code))]));
  for (const [code, count] of findings.slice(0, 8)) {
    $('reasons').append(make('button', { type: 'button', class: 'chip', 'data-code': code, 'aria-pressed': 'false',
      title: (batch.codes.get(code) || [''])[0], onclick: () => setField('finding', state.finding === code ? '' : code) },
      make('code', { text: code }), make('span', { text: ` ${count.toLocaleString('en-US')}` })));
  }
  $('finding').append(option('', 'all'), ...findings.map(([code, count]) => option(code, `${code} (${count})`)));
  $('target').append(option('', 'all'), ...tally(batch.clips.map((c) => c.target)).map(([t, n]) => option(t, `${t} (${n})`)));
  $('sources').append(...tally(batch.clips.map((c) => c.source)).slice(0, 500).map(([s]) => option(s, '')));
  $('metric').append(option('', 'any'));
  $('sort').append(option('worst', 'worst first'), option('name', 'name'));
  batch.metrics.forEach((metric, i) => {
    $('metric').append(option(i, metric.label));
    $('sort').append(option(i, metric.label));
  });
}

// ---- filters

function toggleStatus(status) {
  const on = new Set(state.statuses);
  if (!on.delete(status)) on.add(status);
  state.statuses = STATUSES.filter((s) => on.has(s));
  refresh();
}

function setField(key, value) {
  state[key] = value;
  $(key).value = value;
  refresh();
}

function refresh() {
  writeAddress();
  shown = selectClips(batch.clips, state);
  const all = batch.clips.length;
  $('count').textContent = shown.length === all ? `${all.toLocaleString('en-US')} clips`
    : `${shown.length.toLocaleString('en-US')} of ${all.toLocaleString('en-US')} clips`;
  for (const button of $('verdicts').children) {
    button.setAttribute('aria-pressed', state.statuses.includes(button.dataset.status));
  }
  for (const chip of $('reasons').children) chip.setAttribute('aria-pressed', chip.dataset.code === state.finding);
  $('unit').textContent = state.metric === '' ? '' : batch.metrics[Number(state.metric)].unit;
  const joints = state.view === 'joints';
  $('tab-joints').setAttribute('aria-selected', joints);
  $('tab-clips').setAttribute('aria-selected', !joints);
  $('joints-view').hidden = !joints;
  $('clips-view').hidden = joints;
  if (joints) drawJoints();
  else restartGallery();
}

// ---- the gallery

function restartGallery() {
  $('gallery').replaceChildren();
  drawn = 0;
  $('empty').hidden = shown.length > 0;
  drawMore();
}

function drawMore() {
  if (state.view !== 'clips' || drawn >= shown.length) return;
  const next = shown.slice(drawn, drawn + PAGE);
  drawn += next.length;
  $('gallery').append(...next.map(card));
  // The sentinel reports only when it comes into sight: look again where it never left it.
  watcher.unobserve($('sentinel'));
  watcher.observe($('sentinel'));
}
const watcher = new IntersectionObserver((entries) => {
  if (entries.some((entry) => entry.isIntersecting)) drawMore();
}, { rootMargin: '1200px' });

function pictureOf(clip) {
  if (clip.frames === 0) return null;  // refused: nothing to see
  const picture = make('div', { class: 'picture' });
  const missing = () => picture.replaceChildren(make('span', { text: 'no sheet here' }));
  if (!clip.sheet) {
    missing();
    return picture;
  }
  const image = make('img', { src: `${clip.base}.png`, alt: '', loading: 'lazy', decoding: 'async' });
  image.addEventListener('error', missing);
  picture.append(image);
  return picture;
}

function keyFigures(clip) {
  const line = make('p', { class: 'key' });
  batch.metrics.forEach((metric, i) => {
    if (!metric.short || clip.metrics[i] === null) return;
    const bad = metric.level > 0 && clip.metrics[i] >= metric.level;
    line.append(make('span', { class: bad ? 'bad' : '', title: metric.label,
      text: `${metric.short} ${figure(clip.metrics[i])} ${metric.unit}`.trim() }));
  });
  return line.childNodes.length ? line : null;
}

function card(clip) {
  const status = STATUSES[clip.status], refused = clip.frames === 0;
  const reason = clip.findings.find((f) => f.error) || (clip.status > 0 ? clip.findings.at(-1) : null);
  return make('li', {}, make('a', { class: `card ${status}${refused ? ' refused' : ''}`, href: address(clip.base), 'data-clip': clip.index,
    onclick: (event) => {
      if (event.metaKey || event.ctrlKey || event.shiftKey) return;
      event.preventDefault();
      openClip(clip);
    } },
    pictureOf(clip),
    make('div', { class: 'text' },
      make('p', { class: 'name' }, make('span', { class: `badge ${status}`, text: status }), make('bdi', { text: clip.name })),
      reason ? make('p', { class: 'reason' }, make('bdi', { text: reason.message })) : null,
      refused && reason ? make('p', { class: 'code' }, make('code', { text: reason.code })) : null,
      keyFigures(clip))));
}

// ---- one clip

function openClip(clip) {
  state.open = clip.base;
  writeAddress();
  const status = STATUSES[clip.status], dialog = $('detail');
  $('detail-badge').className = `badge ${status}`;
  $('detail-badge').textContent = status;
  $('detail-name').replaceChildren(make('bdi', { text: clip.name }));
  $('detail-body').replaceChildren(...detailOf(clip, batch));
  $('detail-body').scrollTop = 0;
  dialog.classList.toggle('refused', clip.frames === 0);
  const at = shown.indexOf(clip);
  $('previous').disabled = at <= 0;
  $('next').disabled = at < 0 || at >= shown.length - 1;
  if (!dialog.open) dialog.showModal();
}

function step(by) {
  const at = shown.findIndex((clip) => clip.base === state.open);
  if (at >= 0 && shown[at + by]) openClip(shown[at + by]);
}

function closed() {
  const open = shown.find((clip) => clip.base === state.open);
  state.open = '';
  writeAddress();
  if (open) document.querySelector(`[data-clip="${open.index}"]`)?.focus();
}

// ---- all joints

const JOINT_ORDERS = {
  joint: ['Joint', (a, b) => (a.joint < b.joint ? -1 : 1)],
  time: ['On a limit', (a, b) => b.atLimit / b.frames - a.atLimit / a.frames],
  excess: ['Source beyond', (a, b) => b.beyond / b.frames - a.beyond / a.frames],
  max: ['Furthest', (a, b) => b.max - a.max],
};

function drawJoints() {
  const rows = jointTable(shown, batch.jointsOfTarget).sort(JOINT_ORDERS[jointOrder][1]);
  if (rows.length === 0) {
    $('joints-view').replaceChildren(make('p', { class: 'empty', text: 'No clip here was checked against limits.' }));
    return;
  }
  const edges = batch.edges;
  const classes = [`up to ${edges[0]}\u00b0`, ...edges.slice(1).map((e, i) => `${edges[i]} to ${e}\u00b0`), `more than ${edges.at(-1)}\u00b0`];
  const shares = ['never', ...Array.from({ length: SHARES - 1 }, (_, i) => `${10 * i} to ${10 * i + 10} % of the time`)];
  const head = (key, span) => make('th', { scope: 'col', colspan: span, 'aria-sort': key === jointOrder ? 'descending' : null },
    make('button', { type: 'button', text: JOINT_ORDERS[key][0], onclick: () => { jointOrder = key; drawJoints(); } }));
  const body = make('tbody', {}, ...rows.map((row) => make('tr', {},
    make('th', { scope: 'row' }, make('bdi', { text: row.joint })),
    make('td', { class: 'number', text: percent(row.atLimit, row.frames) }),
    make('td', { class: 'chart' }, columns(row.shares, shares.map((s) => `clips on a limit ${s}`), 'shares')),
    make('td', { class: 'number', text: percent(row.beyond, row.frames) }),
    make('td', { class: 'chart' }, columns(Array.from(classes, (_, i) => row.classes[i] || 0), classes.map((c) => `frames beyond by ${c}`), 'excess')),
    make('td', { class: 'number', text: row.max > 0 ? `${figure(row.max)}\u00b0` : '\u2013' }),
    make('td', { class: 'where' }, row.worst ? make('button', { type: 'button', class: 'link', onclick: () => openClip(row.worst) },
      make('bdi', { text: row.worst.name })) : null))));
  $('joints-view').replaceChildren(
    make('p', { class: 'note muted', text: 'A joint that stands on its limit most of the time, or that most sources ask beyond its limit, may have a wrong limit. '
      + 'Left: clips by share of time on a limit, from never to always. Right: frames in which the source lies beyond the limit, by how far. The filters above apply.' }),
    make('div', { class: 'scroll' }, make('table', { class: 'joints' },
      make('thead', {}, make('tr', {}, head('joint', 1), head('time', 2), head('excess', 2), head('max', 2))), body)));
}

// ---- keys

function moveFocus(key) {
  const cards = [...document.querySelectorAll('.card')];
  const at = cards.indexOf(document.activeElement);
  if (at < 0) return false;
  const top = cards[0].getBoundingClientRect().top;
  const perRow = Math.max(1, cards.filter((c) => c.getBoundingClientRect().top === top).length);
  const by = { ArrowLeft: -1, ArrowRight: 1, ArrowUp: -perRow, ArrowDown: perRow }[key];
  const to = cards[at + by];
  if (to) to.focus();
  return Boolean(to);
}

function onKey(event) {
  if (event.altKey || event.ctrlKey || event.metaKey) return;
  const typing = /^(INPUT|SELECT|TEXTAREA)$/.test(document.activeElement?.tagName || '');
  if ($('detail').open) {
    if (event.key === 'ArrowLeft') step(-1);
    if (event.key === 'ArrowRight') step(1);
  } else if (event.key === '/' && !typing) {
    event.preventDefault();
    $('text').focus();
  } else if (event.key.startsWith('Arrow') && !typing && moveFocus(event.key)) {
    event.preventDefault();
  }
}

// ---- start

function listen() {
  let timer = 0;
  for (const key of FIELDS) {
    $(key).addEventListener('input', () => {
      state[key] = $(key).value;
      clearTimeout(timer);
      timer = setTimeout(refresh, $(key).tagName === 'INPUT' ? 120 : 0);
    });
  }
  $('reset').addEventListener('click', () => {
    Object.assign(state, DEFAULTS, { statuses: [] });
    for (const key of FIELDS) $(key).value = state[key];
    refresh();
  });
  $('more').addEventListener('click', () => {
    const open = $('filters').classList.toggle('open');
    $('more').setAttribute('aria-expanded', open);
  });
  for (const view of ['clips', 'joints']) {
    $(`tab-${view}`).addEventListener('click', () => { state.view = view; refresh(); });
  }
  $('previous').addEventListener('click', () => step(-1));
  $('next').addEventListener('click', () => step(1));
  $('close').addEventListener('click', () => $('detail').close());
  $('detail').addEventListener('click', (event) => { if (event.target === $('detail')) $('detail').close(); });
  $('detail').addEventListener('close', closed);
  document.addEventListener('keydown', onKey);
  window.addEventListener('hashchange', start);
}

function start() {
  readAddress();
  refresh();
  const open = batch.clips.find((clip) => clip.base === state.open);
  if (open) openClip(open);
}

fillTop();
listen();
start();
