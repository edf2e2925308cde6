'use strict';
// What the page knows of its clips, and how it orders, filters and counts them. No document here.

const STATUSES = ['pass', 'warn', 'fail'];
const LETTERS = 'ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_';

/** Text in which nothing is hidden: control characters and those that turn the writing direction
 *  are spelt out. */
function plain(text) {
  return String(text).replace(/[\u0000-\u001f\u007f-\u009f\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff]/g,
    (c) => {
      const code = c.charCodeAt(0);
      if (code < 0x20) return String.fromCharCode(0x2400 + code);
      return '\u2039U+' + code.toString(16).toUpperCase().padStart(4, '0') + '\u203a';
    });
}

/** Values of a plotted line: letters count 63rds of the peak. */
function decodeLine(line) {
  if (!line) return null;
  const [peak, letters] = line;
  return { peak, values: Array.from(letters, (c) => LETTERS.indexOf(c) / 63 * peak) };
}

/** Rows and tables as the program wrote them, as clips with names. */
function readBatch(rows, tables) {
  const name = (i) => (i < 0 ? '' : plain(tables.names[i]));
  const clips = rows.map((row, index) => {
    const clip = {
      index,
      base: row.base,
      name: plain(row.name),
      source: plain(row.source || ''),
      take: plain(row.clip || ''),
      target: name(row.target),
      status: row.status,
      frames: row.frames || 0,
      seconds: row.seconds || 0,
      sheet: row.sheet === 1,
      files: row.files || [],
      facts: plain(row.facts || ''),
      metrics: row.metrics,
      findings: row.findings.map(([code, error, message, joint, frame]) =>
        ({ code: name(code), error: error === 1, message: plain(message), joint: name(joint), frame })),
      effectors: (row.effectors || []).map(([e, reached, p95, max, turn]) =>
        ({ name: name(e), reached, p95, max, turn })),
      limits: row.limits ? row.limits.map(([joint, frames]) => ({ joint: name(joint), frames })) : null,
      bent: (row.bent || []).map(([joint, frames, max, classes]) =>
        ({ joint: name(joint), frames, max, classes })),
      timeline: row.timeline || null,
    };
    clip.severity = severity(clip, tables.metrics);
    clip.haystack = [clip.name, clip.source, clip.take, clip.target,
      ...clip.findings.flatMap((f) => [f.code, f.message, f.joint])].join('\n').toLowerCase();
    return clip;
  });
  return {
    clips,
    folder: plain(tables.folder),
    version: plain(tables.version),
    metrics: tables.metrics,
    edges: tables.excess_edges_deg,
    codes: new Map(Object.entries(tables.codes)),
    jointsOfTarget: jointsOfTarget(clips),
  };
}

/** How far the worst metric is above the level from which it counts as bad. A clip without any
 *  result is worse than every other. */
function severity(clip, metrics) {
  if (clip.frames === 0) return Infinity;
  let worst = 0;
  metrics.forEach((metric, i) => {
    if (metric.level > 0 && clip.metrics[i] !== null) worst = Math.max(worst, clip.metrics[i] / metric.level);
  });
  return worst;
}

const byName = (a, b) => (a.name < b.name ? -1 : a.name > b.name ? 1 : a.index - b.index);

/** Orders of the gallery: 'worst', 'name', or the number of a metric, largest first. */
function comparator(order) {
  if (order === 'name') return byName;
  if (order === 'worst') {
    return (a, b) => b.status - a.status ||
      (b.severity === a.severity ? 0 : b.severity > a.severity ? 1 : -1) || byName(a, b);
  }
  const i = Number(order);
  return (a, b) => (b.metrics[i] ?? -Infinity) - (a.metrics[i] ?? -Infinity) || byName(a, b);
}

function matches(clip, filter) {
  if (filter.statuses.length && !filter.statuses.includes(STATUSES[clip.status])) return false;
  if (filter.target && clip.target !== filter.target) return false;
  if (filter.source && !clip.source.toLowerCase().includes(filter.source.toLowerCase())) return false;
  if (filter.finding && !clip.findings.some((f) => f.code === filter.finding)) return false;
  if (filter.metric !== '' && filter.value !== '') {
    const value = clip.metrics[Number(filter.metric)], bound = Number(filter.value);
    if (value === null || !(filter.sense === 'le' ? value <= bound : value >= bound)) return false;
  }
  return filter.text.toLowerCase().split(/\s+/).every((word) => clip.haystack.includes(word));
}

/** The clips that a filter leaves, in its order. */
function selectClips(clips, filter) {
  return clips.filter((clip) => matches(clip, filter)).sort(comparator(filter.sort));
}

/** How often something occurs, the most frequent first. */
function tally(values) {
  const counts = new Map();
  for (const value of values) counts.set(value, (counts.get(value) || 0) + 1);
  return [...counts].sort((a, b) => b[1] - a[1] || (a[0] < b[0] ? -1 : 1));
}

/** Joints of each target that ever stood on a limit or were asked beyond one. */
function jointsOfTarget(clips) {
  const joints = new Map();
  for (const clip of clips) {
    if (!joints.has(clip.target)) joints.set(clip.target, new Set());
    const set = joints.get(clip.target);
    for (const j of clip.limits || []) set.add(j.joint);
    for (const j of clip.bent) set.add(j.joint);
  }
  return joints;
}

const SHARES = 11;  // classes of time on a limit: never, up to 10 %, ..., up to 100 %

/** Per joint over clips: time on its limits, and how far the sources went beyond them. */
function jointTable(clips, targets) {
  const table = new Map();
  for (const clip of clips) {
    if (!clip.limits || clip.frames === 0) continue;
    const atLimit = new Map(clip.limits.map((j) => [j.joint, j.frames]));
    const bent = new Map(clip.bent.map((j) => [j.joint, j]));
    for (const joint of targets.get(clip.target)) {
      if (!table.has(joint)) {
        table.set(joint, { joint, clips: 0, frames: 0, atLimit: 0, shares: new Array(SHARES).fill(0),
          beyond: 0, classes: [], max: 0, worst: null });
      }
      const row = table.get(joint);
      const frames = Math.min(atLimit.get(joint) || 0, clip.frames);
      row.clips += 1;
      row.frames += clip.frames;
      row.atLimit += frames;
      row.shares[Math.ceil(frames / clip.frames * (SHARES - 1))] += 1;
      const excess = bent.get(joint);
      if (!excess) continue;
      row.beyond += excess.frames;
      excess.classes.forEach((n, k) => { row.classes[k] = (row.classes[k] || 0) + n; });
      if (excess.max > row.max) [row.max, row.worst] = [excess.max, clip];
    }
  }
  return [...table.values()];
}

/** A figure in as few digits as it deserves. */
function figure(value) {
  if (value === null || value === undefined) return '\u2013';
  const size = Math.abs(value);
  if (size >= 1000) return Math.round(value).toLocaleString('en-US');
  if (size >= 100 || Number.isInteger(value)) return String(Math.round(value));
  if (size < 0.005) return value > 0 ? '<0.01' : '>-0.01';
  return value.toFixed(size >= 10 ? 1 : 2);
}

const percent = (part, whole) => {
  const share = whole > 0 ? 100 * part / whole : 0;
  return (share > 0 && share < 1 ? '<1' : Math.round(share)) + ' %';
};
