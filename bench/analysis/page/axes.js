// Axes of a figure: round values, grid, labels.

const MARGIN = { right: 14, top: 10, bottom: 42 };
// Room for the axis label, and the width of a digit beside it, in pixels.
const NAME = 26;
const CHARACTER = 7.2;

// About `count` round values across [low, high].
function ticks(low, high, count) {
  const raw = (high - low) / Math.max(1, count);
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= raw * 0.999);
  const found = [];
  for (let index = Math.ceil(low / step - 1e-9); index * step <= high + step * 1e-9; index++) found.push(index * step);
  return { found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

// The drawing area of a figure of this size, and the conversion between values and pixels.
function axesOf({ width, height }, x, y) {
  const up = ticks(y[0], y[1], (height - MARGIN.top - MARGIN.bottom) / 30);
  const longest = Math.max(4, ...up.found.map((value) => sign(value, up.digits).length));
  const left = Math.round(NAME + CHARACTER * longest + 8);
  const inner = { w: width - left - MARGIN.right, h: height - MARGIN.top - MARGIN.bottom };
  return {
    x, y, up, left, inner,
    across: ticks(x[0], x[1], inner.w / 46),
    bottom: MARGIN.top + inner.h,
    toX: (value) => left + ((value - x[0]) / (x[1] - x[0])) * inner.w,
    toY: (value) => MARGIN.top + ((y[1] - value) / (y[1] - y[0])) * inner.h,
    fromX: (pixel) => x[0] + ((pixel - left) / inner.w) * (x[1] - x[0]),
  };
}

function drawAxes(svg, axes, figure) {
  const { left, inner, bottom, up, across, toX, toY } = axes;
  const lined = !figure.lanes.length;
  for (const value of across.found) {
    const at = round(toX(value));
    if (lined) shape(svg, "path", { class: "gridline", d: `M${at} ${MARGIN.top}v${inner.h}` });
    shape(svg, "text", { x: at, y: bottom + 17, "text-anchor": "middle" }, sign(value, across.digits));
  }
  for (const value of up.found) {
    const at = round(toY(value));
    if (lined) shape(svg, "path", { class: "gridline", d: `M${left} ${at}h${inner.w}` });
    shape(svg, "text", { x: left - 7, y: at + 4, "text-anchor": "end" }, sign(value, up.digits));
  }
  shape(svg, "rect", { class: "frame", x: left, y: MARGIN.top, width: inner.w, height: inner.h });
  const middle = left + inner.w / 2;
  shape(svg, "text", { class: "label", x: middle, y: bottom + 36, "text-anchor": "middle" }, figure.x_label);
  const turn = `translate(14 ${MARGIN.top + inner.h / 2}) rotate(-90)`;
  shape(svg, "text", { class: "label", transform: turn, "text-anchor": "middle" }, figure.y_label);
}

function drawRoad(svg, axes, lanes) {
  if (!lanes.length) return;
  const { left, inner, toY } = axes;
  const edges = lanes.map(([level]) => toY(level));
  const [top, bottom] = [Math.min(...edges), Math.max(...edges)];
  shape(svg, "rect", { class: "road", x: left, y: round(top), width: inner.w, height: round(bottom - top) });
  for (const [level, solid] of lanes) {
    shape(svg, "path", { class: solid ? "edge" : "lane", d: `M${left} ${round(toY(level))}h${inner.w}` });
  }
}
