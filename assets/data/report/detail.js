'use strict';
// One clip in full: its sheet, plots, findings and figures.

const section = (title, ...children) =>
  make('section', { class: `section-${title.split(' ')[0].toLowerCase()}` }, make('h3', { text: title }), ...children);

function sheetOf(clip) {
  if (!clip.sheet) {
    return make('p', { class: 'nosheet', text: 'No contact sheet lies beside the report.' });
  }
  const image = make('img', { src: `${clip.base}.png`, alt: `Contact sheet of ${clip.name}`, decoding: 'async' });
  image.addEventListener('error', () => image.replaceWith(
    make('p', { class: 'nosheet', text: 'The contact sheet is no longer beside this page.' })));
  return make('a', { class: 'sheet', href: `${clip.base}.png`, target: '_blank', rel: 'noopener',
    title: 'Open at full size' }, image);
}

function findingsOf(clip, codes) {
  if (clip.findings.length === 0) return section('Findings', make('p', { class: 'muted', text: 'Nothing to report.' }));
  const list = make('ul', { class: 'findings' });
  for (const finding of clip.findings) {
    const [meaning, wayOut] = codes.get(finding.code) || ['', ''];
    const where = [finding.joint && `joint ${finding.joint}`, finding.frame >= 0 && `frame ${finding.frame}`]
      .filter(Boolean).join(', ');
    list.append(make('li', { class: finding.error ? 'error' : 'warning' },
      make('p', {}, make('bdi', { text: finding.message })),
      meaning ? make('p', { class: 'muted', text: `${meaning} ${wayOut}` }) : null,
      make('p', { class: 'code' }, make('code', { text: finding.code }),
        where ? make('bdi', { text: ` ${where}` }) : null)));
  }
  return section('Findings', list);
}

function figuresOf(clip, metrics) {
  const rows = make('dl', { class: 'figures' });
  metrics.forEach((metric, i) => {
    const value = clip.metrics[i];
    if (value === null) return;
    const bad = metric.level > 0 && value >= metric.level;
    rows.append(make('div', { title: metric.about },
      make('dt', { text: metric.label }),
      make('dd', { class: bad ? 'bad' : '' },
        metric.level > 0 ? meter(value / (2 * metric.level), bad ? 'bad' : 'good') : null,
        make('span', { text: `${figure(value)} ${metric.unit}`.trim() }))));
  });
  return section('Figures', rows);
}

function table(heads, rows) {
  return make('div', { class: 'scroll' }, make('table', {},
    make('thead', {}, make('tr', {}, ...heads.map((text) => make('th', { scope: 'col', text })))),
    make('tbody', {}, ...rows.map((cells) => make('tr', {}, ...cells.map((text, i) =>
      (i === 0 ? make('th', { scope: 'row' }, make('bdi', { text })) : make('td', { text }))))))));
}

function effectorsOf(clip) {
  if (clip.effectors.length === 0) return null;
  return section('Effectors', table(['effector', 'p95 mm', 'max mm', 'p95 \u00b0', 'reached'],
    clip.effectors.map((e) => [e.name, figure(e.p95), figure(e.max), figure(e.turn), percent(e.reached, clip.frames)])));
}

/** Both halves of the blame: where the result stands on a limit, and who asked for more. */
function limitsOf(clip) {
  if (!clip.limits) return null;
  const parts = [];
  if (clip.limits.length) {
    const list = make('dl', { class: 'figures' });
    for (const j of clip.limits.slice(0, 12)) {
      list.append(make('div', {}, make('dt', {}, make('bdi', { text: j.joint })),
        make('dd', {}, meter(j.frames / clip.frames, 'limit'), make('span', { text: percent(j.frames, clip.frames) }))));
    }
    parts.push(section('Time on a limit', list));
  }
  if (clip.bent.length) {
    const list = make('ul', { class: 'blame' });
    for (const j of clip.bent.slice(0, 12)) {
      list.append(make('li', {}, make('bdi', { text: j.joint }),
        ` up to ${figure(j.max)}\u00b0 beyond its limit, in ${figure(j.frames)} frames`));
    }
    parts.push(section('What the source asks for', list));
  }
  return parts.length ? make('div', { class: 'pair' }, ...parts) : null;
}

function plotsOf(clip) {
  const t = clip.timeline;
  if (!t) return null;
  const lines = [['error', 'Largest effector error', 'mm'], ['excess', 'Source beyond the limits', '\u00b0'],
    ['limits', 'Joints on a limit', '']]
    .map(([key, label, unit]) => ({ label, unit, line: decodeLine(t[key]), className: `plot-${key}` }))
    .filter(({ line }) => line !== null);
  return lines.length ? section('Over time', timePlots(lines, t.contacts, clip.seconds)) : null;
}

function filesOf(clip) {
  const links = make('p', { class: 'files' });
  for (const suffix of [...clip.files, 'report.json']) {
    links.append(make('a', { href: `${clip.base}.${suffix}`, target: '_blank', rel: 'noopener', text: suffix }), ' ');
  }
  const facts = make('dl', { class: 'facts' });
  const add = (term, text) => {
    if (text) facts.append(make('dt', { text: term }), make('dd', {}, make('bdi', { text })));
  };
  add('Source', clip.source);
  add('Clip', clip.take);
  add('Target', clip.target);
  add('Read as', clip.facts);
  if (clip.frames) add('Length', `${figure(clip.frames)} frames, ${figure(clip.seconds)} s`);
  return section('Files', facts, links);
}

function detailOf(clip, batch) {
  return [
    make('div', { class: 'wide' }, sheetOf(clip), plotsOf(clip), limitsOf(clip), effectorsOf(clip)),
    make('div', { class: 'side' }, findingsOf(clip, batch.codes), clip.frames ? figuresOf(clip, batch.metrics) : null, filesOf(clip)),
  ];
}
