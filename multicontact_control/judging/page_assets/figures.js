// Draws the figures of a page with uPlot, each from the numbers in its element.
'use strict';

const FONT = '12px system-ui, sans-serif', GRID = '#e6e6e6', TEXT = '#444';
const TIME = 'time [s]', HEIGHT = 240;  // px, without title and legend

// Returns where a sample stands alone, so that no line shows it.
function alone(values) {
  const found = [], unknown = i => values[i] === null || values[i] === undefined;
  values.forEach((value, i) => {
    if (value !== null && unknown(i - 1) && unknown(i + 1)) found.push(i);
  });
  return found;
}

function curve(style, values) {
  const number = (_, value) => value === null ? '' : String(Number(value.toPrecision(4)));
  const shown = {label: style.label, stroke: style.colour, value: number,
    width: style.broad ? 5 : 1, alpha: style.broad ? 0.3 : style.faint ? 0.6 : 1, dash: style.dashed ? [6, 4] : undefined};
  const single = alone(values);
  return {...shown, points: {
    size: 4, filter: (_, k, all) => all || !single.length ? null : single}};
}

function limits(plot) {
  if (plot.logarithmic) {
    return (_, low, high) => low === null || low === undefined ? [0.1, 10] :
      uPlot.rangeLog(low, high, 10, false);
  }
  return (_, low, high) => {
    if (low === null || low === undefined) return [0, 1];
    const more = Math.max(plot.least - (high - low), 0) / 2;
    return uPlot.rangeNum(low - more, high + more, 0.1, false);
  };
}

function shade(u, plot) {
  const {top, height} = u.bbox;
  u.ctx.save();
  inside(u, plot.shaded).forEach(([name, from, to]) => {
    u.ctx.fillStyle = plot.shades[name];
    u.ctx.fillRect(from, top, to - from, height);
  });
  u.ctx.restore();
}

// Returns name, left and right of the stretches that are in sight.
function inside(u, shaded) {
  const first = u.bbox.left, last = first + u.bbox.width;
  return shaded.map(([name, start, end]) => [
    name, Math.max(u.valToPos(start, 'x', true), first),
    Math.min(u.valToPos(end, 'x', true), last)]).filter(([, from, to]) => to > from);
}

function annotate(u, plot) {
  const top = u.bbox.top, context = u.ctx;
  context.save();
  context.font = u.axes[0].font[0];
  context.fillStyle = '#555';
  context.strokeStyle = '#fff';
  context.lineWidth = 4;
  context.textAlign = 'left';
  context.textBaseline = 'top';
  inside(u, plot.shaded).forEach(([name, from, to]) => {
    if (context.measureText(name).width + 4 > to - from) return;
    context.strokeText(name, from + 2, top + 4);
    context.fillText(name, from + 2, top + 4);
  });
  context.restore();
}

// Keeps the lines of whole decades where all of them would be a grey area.
function decades(u, marks) {
  const {min, max} = u.scales.y;
  return max < 1000 * min ? marks :
    marks.map(mark => Number.isInteger(Math.log10(mark)) ? mark : null);
}

// Returns the texts of the marks of a linear axis, with the digits that tell them apart.
function marks(_, values, axis, space, step) {
  let digits = 0;
  while (digits < 9 && Math.abs(step - Number(step.toFixed(digits))) > 1e-3 * step) digits++;
  return values.map(value => (Math.abs(value) < step / 2 ? 0 : value).toFixed(digits));
}

// Returns the texts of the marks of a logarithmic axis.
function powers(_, values) {
  return values.map(value => value === null ? '' : String(Number(value.toPrecision(3))));
}

function options(plot, width) {
  const axis = {font: FONT, labelFont: FONT, stroke: TEXT, labelSize: 20,
    grid: {stroke: GRID, width: 1}, ticks: {stroke: GRID, width: 1}};
  const up = {...axis, size: 58, label: plot.label, values: plot.logarithmic ? powers : marks};
  const across = {...axis, size: 34, label: TIME, values: marks};
  return {
    title: plot.heading || undefined, width, height: HEIGHT,
    cursor: {y: false, drag: {x: true, y: true, uni: 30, dist: 4}, focus: {prox: 20},
      sync: {key: 'time', scales: ['x', null]}},
    scales: {
      x: {time: false},
      y: {distr: plot.logarithmic ? 3 : 1, range: limits(plot)}},
    axes: [across, plot.logarithmic ? {...up, grid: {...up.grid, filter: decades}} : up],
    series: [
      {label: TIME, value: (_, x) => x === null || x === undefined ? '' : x.toFixed(3)},
      ...plot.curves.map((style, i) => curve(style, plot.data[i + 1]))],
    hooks: {drawClear: [u => shade(u, plot)], draw: [u => annotate(u, plot)]}};
}

// Draws plots into an element, below each other, instead of what is in it.
function drawFigure(place, plots) {
  place.replaceChildren();
  place.plots = plots.map(plot => {
    const below = document.createElement('div');
    below.setAttribute('aria-label', [plot.heading, plot.label].filter(Boolean).join(', '));
    place.append(below);
    return new uPlot(options(plot, place.clientWidth), plot.data, below);
  });
  new ResizeObserver(() => place.plots.forEach(drawn => {
    if (drawn.width !== place.clientWidth) {
      drawn.setSize({width: place.clientWidth, height: drawn.height});
    }
  })).observe(place);
  place.dataset.state = 'drawn';
}

document.addEventListener('DOMContentLoaded', () => {
  document.querySelectorAll('.figure').forEach(place => {
    const content = place.querySelector('script');
    if (content) drawFigure(place, JSON.parse(content.textContent));
  });
});
