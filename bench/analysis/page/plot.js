// One figure: curves as SVG, legend, cursor, and pointer input.

// Widths of figures on an A4 page, so that text keeps its size in print.
const PAPER = { wide: 690, narrow: 330 };

let printing = false;

// A point is read until this long after it (s): times of steps come every 50 ms.
const POINT_S = 0.1;

// Index of the value of a curve at a time, -1 for none; of a curve of points that of the last point.
function lastIndex(curve, time) {
  const times = data.pool[curve.at];
  const now = indexAt(times, time);
  if (!curve.points) return now;
  let index = now;
  while (index > 0 && data.pool[curve.y][index] === null && times[index] > time - POINT_S) index--;
  return index >= 0 && data.pool[curve.y][index] === null ? now : index;
}

class Plot {
  constructor(parent, figure) {
    this.figure = figure;
    this.hidden = new Set();
    this.visible = true;
    // What to redraw when it comes into view: null, "cursor" or "all".
    this.stale = null;
    this.card = element(parent, "section", { class: figure.wide ? "card wide" : "card", id: figure.id });
    const head = element(this.card, "div", { class: "head" });
    element(head, "h3", {}, figure.title);
    addSaving(head, figure.title.replace(/ +/g, " "), { name: figure.id, svg: () => this.file(), csv: () => figureCsv(figure) });
    this.keys = element(this.card, "div", { class: "keys" });
    this.svg = shape(this.card, "svg", { class: "plot", role: "img", "aria-label": figure.title.replace(/ +/g, " ") });
    if (figure.caption) element(this.card, "p", { class: "caption" }, figure.caption);
    this.readings = figure.curves.map((curve, index) => this.addKey(curve, index));
    this.svg.addEventListener("pointermove", (event) => this.pointed(event));
    this.svg.addEventListener("pointerdown", (event) => this.pressed(event));
    this.svg.addEventListener("pointerup", () => this.released());
    this.svg.addEventListener("pointercancel", () => this.endBrush());
    this.svg.addEventListener("dblclick", () => setRange(null));
  }

  addKey(curve, index) {
    // Curves of one name share a key: a value and its reference, in both runs.
    const first = this.figure.curves.findIndex((other) => other.name === curve.name);
    if (!curve.name || first !== index) return null;
    const key = element(this.keys, "button", { class: "key", type: "button", "aria-pressed": "true" });
    const sample = element(key, "i", { class: curve.dash ? "dash" : "" });
    sample.style.borderColor = ink(curve.colour);
    key.append(curve.name);
    const value = element(key, "b");
    // Reserve room for the values, so that the layout does not move with the cursor.
    const beside = this.figure.curves.filter((other) => other.name === curve.name && other.at && this.inLayer(other));
    value.style.minWidth = `${beside.length * READING + Math.max(0, beside.length - 1) * 2}ch`;
    key.addEventListener("click", () => {
      if (!this.hidden.delete(curve.name)) this.hidden.add(curve.name);
      key.setAttribute("aria-pressed", String(!this.hidden.has(curve.name)));
      this.draw();
    });
    return value;
  }

  // The figure as shown, as an SVG file.
  file() {
    this.draw();
    const { figure } = this;
    const legend = [];
    for (const curve of this.shown()) {
      const text = [curve.run, curve.name].filter(Boolean).join(" ");
      if (curve.name && !legend.some((key) => key.text === text)) {
        legend.push({ text, colour: lightInk(curve.colour), dash: curve.run === "B" || curve.dash });
      }
    }
    return standalone(this.svg, { title: figure.title.replace(/ +/g, " "), legend, caption: figure.caption });
  }

  inLayer(curve) {
    return !curve.run || (layers[curve.run] && (layers.second || !curve.dash));
  }

  isShown(curve) {
    return this.inLayer(curve) && !this.hidden.has(curve.name);
  }

  shown() {
    return this.figure.curves.filter((curve) => this.isShown(curve));
  }

  // Data range of a coordinate; over time only within the shown range.
  extent(axis) {
    let low = Infinity;
    let high = -Infinity;
    for (const curve of this.shown()) {
      const values = data.pool[curve[axis]];
      const at = this.figure.time && cursor.range ? data.pool[curve.x] : null;
      for (let index = 0; index < values.length; index++) {
        const value = values[index];
        if (value === null) continue;
        if (at && (at[index] < cursor.range[0] || at[index] > cursor.range[1])) continue;
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    return [low, high];
  }

  ranges() {
    const { figure } = this;
    let x = figure.x_range.length ? figure.x_range : this.extent("x");
    if (figure.time) x = shownRange();
    const y = this.extent("y");
    const zoomed = figure.time && cursor.range;
    for (const value of zoomed ? [] : [...figure.y_range, ...figure.lines.map((line) => line.y)]) {
      y[0] = Math.min(y[0], value);
      y[1] = Math.max(y[1], value);
    }
    // No data, or none yet.
    if (!Number.isFinite(y[0])) [y[0], y[1]] = [0, 1];
    if (!Number.isFinite(x[0])) x = [0, 1];
    if (!(x[1] > x[0])) x = [x[0] - 1, x[0] + 1];
    const size = y[1] - y[0];
    const spare = size > 1e-9 * Math.max(1, Math.abs(y[0])) ? size * 0.06 : Math.max(1e-6, Math.abs(y[0]) * 0.05);
    if (figure.y_top !== null && !zoomed) return { x, y: [0, figure.y_top] };
    const bottom = y[0] === 0 && figure.y_range[0] === 0 ? 0 : y[0] - spare;
    return { x, y: [bottom, y[1] + spare] };
  }

  draw() {
    this.stale = null;
    this.readings.forEach((value, number) => {
      const { name } = this.figure.curves[number];
      if (value) value.parentElement.hidden = !this.figure.curves.some((curve) => curve.name === name && this.inLayer(curve));
    });
    const onPaper = this.figure.wide ? PAPER.wide : PAPER.narrow;
    const width = printing ? onPaper : Math.max(240, this.card.clientWidth - 2 * parseFloat(getComputedStyle(this.card).paddingLeft));
    const height = Math.round(this.figure.wide ? clamp(width * 0.27, 230, 330) : Math.min(300, width * 0.6));
    this.width = width;
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.svg.replaceChildren();
    const { x, y } = this.ranges();
    this.axes = axesOf({ width, height }, x, y);
    const { left, inner } = this.axes;
    const clip = `clip-${this.figure.id}`;
    const defined = shape(shape(this.svg, "defs"), "clipPath", { id: clip });
    shape(defined, "rect", { x: left, y: MARGIN.top, width: inner.w, height: inner.h });
    drawRoad(this.svg, this.axes, this.figure.lanes);
    drawAxes(this.svg, this.axes, this.figure);
    this.body = shape(this.svg, "g", { "clip-path": `url(#${clip})` });
    this.drawLines();
    for (const curve of this.shown()) this.drawCurve(curve);
    this.over = shape(this.svg, "g", { "clip-path": `url(#${clip})`, class: "over" });
    this.line = this.figure.time ? shape(this.over, "path", { class: "cursor" }) : null;
    this.dots = this.figure.curves.map((curve) => {
      if (!curve.at || !this.isShown(curve)) return null;
      const dot = shape(this.over, "circle", { class: curve.run === "B" ? "dot b" : "dot", r: curve.dash ? 3 : 4 });
      dot.style.fill = ink(curve.colour);
      return dot;
    });
    this.selection = shape(this.over, "rect", { class: "brush", y: MARGIN.top, height: inner.h, width: 0 });
    if (this.figure.time) drawMarks(this.svg, x, this.axes.toX, { top: MARGIN.top, height: inner.h });
    this.drawCursor();
  }

  drawLines() {
    const { left, inner, toY } = this.axes;
    for (const line of this.figure.lines) {
      const at = round(toY(line.y));
      shape(this.body, "path", { class: line.limit ? "level limit" : "level", d: `M${left} ${at}h${inner.w}` });
      if (!line.name) continue;
      const placed = { class: "mark-text", x: left + inner.w - 5, y: at - 4, "text-anchor": "end" };
      shape(this.body, "text", placed, line.name);
    }
  }

  drawCurve(curve) {
    const { toX, toY } = this.axes;
    const [xs, ys] = [data.pool[curve.x], data.pool[curve.y]];
    let d = "";
    let pen = "M";
    for (let index = 0; index < xs.length; index++) {
      if (xs[index] === null || ys[index] === null) {
        pen = "M";
        continue;
      }
      const [px, py] = [round(toX(xs[index])), round(toY(ys[index]))];
      if (curve.points) d += `M${px} ${py}h0`;
      else d += curve.step && pen === "L" ? `H${px}V${py}` : `${pen}${px} ${py}`;
      pen = "L";
    }
    const path = shape(this.body, "path", { class: this.look(curve), d });
    path.style.stroke = ink(curve.colour);
    if (!curve.fill || curve.run === "B" || !xs.length) return;
    const floor = round(toY(0));
    path.setAttribute("d", `${d}V${floor}H${round(toX(xs[0]))}Z`);
    path.classList.add("fill");
    path.style.fill = ink(curve.colour);
    path.style.fillOpacity = 0.35;
  }

  // With two runs, B's curves are dashed, and curves that are dashed for a single run are dotted.
  look(curve) {
    const b = curve.run === "B" ? " b" : "";
    if (curve.points) return `curve points${b}`;
    if (curve.run && curve.dash) return `curve dots${b}`;
    return curve.dash || b ? `curve dash${b}` : "curve";
  }

  // The cursor, a dot on each curve, and the values in the legend.
  drawCursor() {
    if (this.stale === "cursor") this.stale = null;
    const { toX, toY, inner } = this.axes;
    const { time } = cursor;
    if (this.line) this.line.setAttribute("d", `M${round(toX(time))} ${MARGIN.top}v${inner.h}`);
    const texts = {};
    this.figure.curves.forEach((curve, number) => {
      const index = curve.at ? lastIndex(curve, time) : -1;
      const [x, y] = index < 0 ? [null, null] : [data.pool[curve.x][index], data.pool[curve.y][index] ?? null];
      if (index >= 0 && this.isShown(curve)) (texts[curve.name] ??= []).push(reading(y));
      const dot = this.dots[number];
      if (!dot) return;
      const there = x !== null && y !== null;
      dot.style.display = there ? "" : "none";
      if (there) place(dot, { cx: round(toX(x)), cy: round(toY(y)) });
    });
    this.readings.forEach((shownAt, number) => {
      if (shownAt) shownAt.textContent = (texts[this.figure.curves[number].name] ?? []).join(" | ");
    });
    const [from, to] = this.brush ? [this.brush.from, this.brush.to].map(toX).sort((a, b) => a - b) : [0, 0];
    place(this.selection, { x: from, width: to - from });
  }

  // The time pointed at: on the axis, or of the nearest point of a curve.
  timeAt(event) {
    const box = this.svg.getBoundingClientRect();
    const scale = this.width / box.width;
    const [x, y] = [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
    const { toX, toY, fromX } = this.axes;
    if (this.figure.time) return clamp(fromX(x), ...shownRange());
    let best = null;
    let least = Infinity;
    for (const curve of this.shown()) {
      if (!curve.at) continue;
      const [xs, ys] = [data.pool[curve.x], data.pool[curve.y]];
      for (let index = 0; index < xs.length; index++) {
        if (xs[index] === null || ys[index] === null) continue;
        const distance = (toX(xs[index]) - x) ** 2 + (toY(ys[index]) - y) ** 2;
        if (distance < least) [least, best] = [distance, data.pool[curve.at][index]];
      }
    }
    return best;
  }

  pointed(event) {
    // A mouse that only passes over does not stop the player.
    if (player.playing && event.pointerType === "mouse" && !this.brush) return;
    const time = this.timeAt(event);
    if (this.brush) this.brush.to = time;
    if (time !== null) takeTime(time);
  }

  pressed(event) {
    player.pause();
    this.pointed(event);
    if (!this.figure.time || event.pointerType !== "mouse" || event.button !== 0) return;
    this.svg.setPointerCapture(event.pointerId);
    const time = this.timeAt(event);
    this.brush = { from: time, to: time };
  }

  released() {
    if (!this.brush) return;
    const { toX } = this.axes;
    const range = [this.brush.from, this.brush.to].sort((a, b) => a - b);
    this.endBrush();
    if (toX(range[1]) - toX(range[0]) > 6) setRange(range);
  }

  endBrush() {
    this.brush = null;
    this.drawCursor();
  }
}

// ---- all figures: those in view are drawn at once, the others later or when they come into view

const plots = [];
const LATER_MS = 250;
let later = null;

const observer = new IntersectionObserver((entries) => {
  for (const entry of entries) {
    const plot = plots.find((each) => each.card === entry.target);
    if (!plot) continue;
    plot.visible = entry.isIntersecting;
    if (plot.visible) refresh(plot);
  }
}, { rootMargin: "200px" });

function refresh(plot) {
  if (plot.stale === "all") plot.draw();
  else if (plot.stale === "cursor") plot.drawCursor();
}

function drawPlots(what, chosen = () => true) {
  for (const plot of plots.filter(chosen)) {
    if (plot.stale !== "all") plot.stale = what;
    if (plot.visible || printing) refresh(plot);
  }
  later ??= setTimeout(() => {
    later = null;
    for (const plot of plots) if (plot.stale === "cursor") plot.drawCursor();
  }, LATER_MS);
}

function makePlots(parent) {
  observer.disconnect();
  plots.length = 0;
  parent.replaceChildren();
  let group = null;
  let grid = null;
  for (const figure of data.figures) {
    if (figure.group !== group) {
      group = figure.group;
      element(parent, "h2", {}, group);
      grid = element(parent, "div", { class: "grid" });
    }
    plots.push(new Plot(grid, figure));
  }
  for (const plot of plots) {
    plot.draw();
    observer.observe(plot.card);
  }
}

onTime.push(() => drawPlots("cursor"));
onRange.push(() => drawPlots("all", (plot) => plot.figure.time));
