'use strict';
// Elements and small charts. Text enters the document through textContent alone.

/** An element with properties, attributes (aria-*, data-*, role...) and children. */
function make(tag, options = {}, ...children) {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(options)) {
    if (key === 'text') element.textContent = value;
    else if (key === 'class') element.className = value;
    else if (key.startsWith('on')) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, '');
    else if (value !== false && value !== null) element.setAttribute(key, value);
  }
  element.append(...children.filter((child) => child !== null));
  return element;
}

function svg(tag, attributes, ...children) {
  const element = document.createElementNS('http://www.w3.org/2000/svg', tag);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

/** Columns of counts; heights grow with the square root, so that rare classes stay visible. */
function columns(counts, labels, className) {
  const most = Math.max(1, ...counts), n = counts.length;
  const chart = svg('svg', { viewBox: `0 0 ${n * 10} 30`, class: `columns ${className}`, role: 'img',
    'aria-label': counts.map((c, i) => `${labels[i]}: ${c}`).join('; ') });
  counts.forEach((count, i) => {
    const height = count > 0 ? Math.max(1.5, 29 * Math.sqrt(count / most)) : 0;
    const column = svg('g', {},
      svg('rect', { x: i * 10, y: 0, width: 10, height: 30, class: 'hit' }),
      svg('rect', { x: i * 10 + 1, y: 29.5 - height, width: 8, height, class: `c c${i}` }),
      svg('rect', { x: i * 10 + 1, y: 29.5, width: 8, height: 0.5, class: 'floor' }));
    const title = svg('title', {});
    title.textContent = `${labels[i]}: ${count.toLocaleString('en-US')}`;
    column.append(title);
    chart.append(column);
  });
  return chart;
}

/** A bar that fills a share (0..1) of its width. */
function meter(share, className) {
  const bar = make('span', { class: `fill ${className}` });
  bar.style.width = `${100 * Math.min(1, Math.max(0, share))}%`;
  return make('span', { class: 'meter', 'aria-hidden': 'true' }, bar);
}

/** Lines over time that share one cursor: [{label, unit, line: {peak, values}}], contacts as a
 *  string of letters (A none, B left, C right, D both). */
function timePlots(lines, contacts, seconds) {
  const box = make('div', { class: 'plots' });
  const tracks = [];
  for (const { label, unit, line, className } of lines) {
    const top = line.peak > 0 ? line.peak : 1, n = line.values.length;
    const x = (i) => (i + 0.5) / n * 1000, y = (v) => 58 - 54 * v / top;
    const points = line.values.map((v, i) => `${x(i).toFixed(1)},${y(v).toFixed(1)}`);
    const first = points[0].split(',')[1], last = points[n - 1].split(',')[1];
    const outline = `M0,${first}L${points.join('L')}L1000,${last}`;
    const readout = make('span', { class: 'readout', text: `peak ${figure(line.peak)} ${unit}` });
    const cursor = svg('line', { y1: 0, y2: 60, class: 'cursor' });
    box.append(make('div', { class: 'plot' },
      make('div', { class: 'caption' }, make('span', { text: label }), readout),
      svg('svg', { viewBox: '0 0 1000 60', preserveAspectRatio: 'none', class: className, 'aria-hidden': 'true' },
        svg('line', { x1: 0, x2: 1000, y1: 59, y2: 59, class: 'axis' }),
        svg('path', { d: `${outline}V59H0Z`, class: 'area' }), svg('path', { d: outline, class: 'line' }), cursor)));
    tracks.push({ line, unit, readout, cursor, idle: readout.textContent });
  }
  if (contacts) box.append(contactBars(contacts));
  const axis = make('div', { class: 'times' });
  for (let k = 0; k <= 4; ++k) axis.append(make('span', { text: `${figure(seconds * k / 4)} s` }));
  box.append(axis);
  followPointer(box, tracks, seconds);
  return box;
}

function contactBars(contacts) {
  const n = contacts.length;
  const bars = make('div', { class: 'plot contacts' },
    make('div', { class: 'caption' }, make('span', { text: 'Foot contacts, left and right' })));
  for (const [bit, side] of [[1, 'left'], [2, 'right']]) {
    const chart = svg('svg', { viewBox: '0 0 1000 10', preserveAspectRatio: 'none', class: side, 'aria-hidden': 'true' });
    chart.append(svg('rect', { x: 0, y: 0, width: 1000, height: 10, class: 'ground' }));
    for (let i = 0; i < n; ++i) {
      if (!((LETTERS.indexOf(contacts[i]) >> (bit - 1)) & 1)) continue;
      let end = i;
      while (end < n && ((LETTERS.indexOf(contacts[end]) >> (bit - 1)) & 1)) ++end;
      chart.append(svg('rect', { x: i / n * 1000, y: 0, width: (end - i) / n * 1000, height: 10, class: 'stand' }));
      i = end;
    }
    bars.append(chart);
  }
  return bars;
}

function followPointer(box, tracks, seconds) {
  box.addEventListener('pointermove', (event) => {
    const area = box.getBoundingClientRect();
    const share = Math.min(0.9999, Math.max(0, (event.clientX - area.left) / area.width));
    for (const { line, unit, readout, cursor } of tracks) {
      const value = line.values[Math.floor(share * line.values.length)];
      readout.textContent = `${figure(share * seconds)} s: ${figure(value)} ${unit}`;
      cursor.setAttribute('x1', share * 1000);
      cursor.setAttribute('x2', share * 1000);
    }
    box.classList.add('live');
  });
  box.addEventListener('pointerleave', () => {
    for (const { readout, idle } of tracks) readout.textContent = idle;
    box.classList.remove('live');
  });
}
