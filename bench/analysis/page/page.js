// Draws a run's report from the data in the page: figures as SVG, one time cursor and one time range for all of them.
"use strict";

(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const pool = data.pool;
  const SVG = "http://www.w3.org/2000/svg";
  const MARGIN = { right: 14, top: 10, bottom: 42 };
  // Room for the axis' name and, beside it, for numbers of so many pixels a character.
  const NAME = 26;
  const CHARACTER = 7.2;

  // What all figures share: the time pointed at (s) and the range of time shown, null for all of the run.
  const shared = { time: null, range: null };
  const plots = [];

  // Widths of figures on an A4 page; on paper their text keeps its size.
  const PAPER = { wide: 690, narrow: 330 };
  let printing = false;

  // ---- small helpers

  function element(parent, tag, attributes = {}, text = null) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    if (text !== null) made.textContent = text;
    parent.append(made);
    return made;
  }

  function shape(parent, tag, attributes = {}, text = null) {
    const made = document.createElementNS(SVG, tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    if (text !== null) made.textContent = text;
    parent.append(made);
    return made;
  }

  const round = (value) => Math.round(value * 10) / 10;

  function ink(colour) {
    if (colour === "limit") return "var(--limit)";
    return colour === "ink" ? "var(--ink)" : colour;
  }

  // About `count` round values across [low, high].
  function ticks(low, high, count) {
    const raw = (high - low) / Math.max(1, count);
    const power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((factor) => factor * power).find((candidate) => candidate >= raw * 0.999);
    const found = [];
    for (let index = Math.ceil(low / step - 1e-9); index * step <= high + step * 1e-9; index++) found.push(index * step);
    return { found, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
  }

  // A value as a person reads it next to the figure.
  function reading(value) {
    if (value === null || value === undefined) return "–";
    const size = Math.abs(value);
    if (size >= 1000) return value.toFixed(0);
    if (size >= 10) return value.toFixed(2);
    if (size < 1e-4) return size === 0 ? "0" : value.toExponential(1);
    return value.toFixed(size >= 1 ? 3 : 4);
  }

  // Index of the last of the rising `times` that is not after `time`; -1 before the first.
  function indexAt(times, time) {
    let low = -1;
    let high = times.length;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] <= time + 1e-9) low = middle;
      else high = middle;
    }
    return low;
  }

  const times = pool.t;
  const firstTime = times[0];
  const lastTime = times[times.length - 1];

  // ---- one figure

  class Plot {
    constructor(parent, figure) {
      this.figure = figure;
      this.hidden = new Set();
      this.card = element(parent, "section", { class: figure.wide ? "card wide" : "card", id: figure.id });
      element(this.card, "h3", {}, figure.title);
      this.keys = element(this.card, "div", { class: "keys" });
      this.svg = shape(this.card, "svg", { class: "plot", role: "img", "aria-label": figure.title.replace(/ +/g, " ") });
      if (figure.caption) element(this.card, "p", { class: "caption" }, figure.caption);
      this.readings = figure.curves.map((curve, index) => this.addKey(curve, index));
      this.svg.addEventListener("pointermove", (event) => this.pointed(event));
      this.svg.addEventListener("pointerdown", (event) => this.pressed(event));
      this.svg.addEventListener("pointerup", (event) => this.released(event));
      this.svg.addEventListener("pointercancel", () => this.endBrush());
      this.svg.addEventListener("pointerleave", (event) => {
        if (event.pointerType === "mouse" && !this.brush) setTime(null);
      });
      this.svg.addEventListener("dblclick", () => setRange(null));
    }

    addKey(curve, index) {
      // Curves of one name share a key: a value and its reference.
      const first = this.figure.curves.findIndex((other) => other.name === curve.name);
      if (!curve.name || first !== index) return null;
      const key = element(this.keys, "button", { class: "key", type: "button", "aria-pressed": "true" });
      const sample = element(key, "i", { class: curve.dash ? "dash" : "" });
      sample.style.borderColor = ink(curve.colour);
      key.append(curve.name);
      const value = element(key, "b");
      key.addEventListener("click", () => {
        if (!this.hidden.delete(curve.name)) this.hidden.add(curve.name);
        key.setAttribute("aria-pressed", String(!this.hidden.has(curve.name)));
        this.draw();
      });
      return value;
    }

    shown() {
      return this.figure.curves.filter((curve) => !this.hidden.has(curve.name));
    }

    // Data range of a coordinate; over time only of what the range of time shows.
    extent(axis) {
      let low = Infinity;
      let high = -Infinity;
      for (const curve of this.shown()) {
        const values = pool[curve[axis]];
        const at = this.figure.time && shared.range ? pool[curve.x] : null;
        for (let index = 0; index < values.length; index++) {
          const value = values[index];
          if (value === null) continue;
          if (at && (at[index] < shared.range[0] || at[index] > shared.range[1])) continue;
          if (value < low) low = value;
          if (value > high) high = value;
        }
      }
      return [low, high];
    }

    ranges() {
      const { figure } = this;
      let x = figure.x_range.length ? figure.x_range : this.extent("x");
      if (figure.time) x = shared.range ?? [firstTime, lastTime];
      const y = this.extent("y");
      const zoomed = figure.time && shared.range;
      for (const value of zoomed ? [] : [...figure.y_range, ...figure.lines.map((line) => line.y)]) {
        y[0] = Math.min(y[0], value);
        y[1] = Math.max(y[1], value);
      }
      if (!Number.isFinite(y[0])) y[0] = y[1] = 0;
      if (!Number.isFinite(x[0])) x = [0, 1];
      const size = y[1] - y[0];
      const spare = size > 1e-9 * Math.max(1, Math.abs(y[0])) ? size * 0.06 : Math.max(1e-6, Math.abs(y[0]) * 0.05);
      if (figure.y_top !== null && !zoomed) return { x, y: [0, figure.y_top] };
      const bottom = y[0] === 0 && figure.y_range[0] === 0 ? 0 : y[0] - spare;
      return { x: x[1] > x[0] ? x : [x[0] - 1, x[0] + 1], y: [bottom, y[1] + spare] };
    }

    draw() {
      const onPaper = this.figure.wide ? PAPER.wide : PAPER.narrow;
      const width = printing ? onPaper : Math.max(280, this.card.clientWidth - 28);
      const height = Math.round(this.figure.wide ? Math.max(230, Math.min(330, width * 0.27)) : Math.min(300, width * 0.6));
      this.size = { width, height };
      this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
      this.svg.replaceChildren();
      const { x, y } = this.ranges();
      const up = ticks(y[0], y[1], (height - MARGIN.top - MARGIN.bottom) / 30);
      const longest = Math.max(4, ...up.found.map((value) => sign(value, up.digits).length));
      this.left = Math.round(NAME + CHARACTER * longest + 8);
      const inner = { w: width - this.left - MARGIN.right, h: height - MARGIN.top - MARGIN.bottom };
      this.inner = inner;
      this.toX = (value) => this.left + ((value - x[0]) / (x[1] - x[0])) * inner.w;
      this.toY = (value) => MARGIN.top + ((y[1] - value) / (y[1] - y[0])) * inner.h;
      this.fromX = (pixel) => x[0] + ((pixel - this.left) / inner.w) * (x[1] - x[0]);
      const clip = `clip-${this.figure.id}`;
      shape(shape(shape(this.svg, "defs"), "clipPath", { id: clip }), "rect", {
        x: this.left, y: MARGIN.top, width: inner.w, height: inner.h,
      });
      this.drawRoad();
      this.drawAxes(x, up);
      this.body = shape(this.svg, "g", { "clip-path": `url(#${clip})` });
      this.drawLines();
      this.drawEvents(x);
      for (const curve of this.shown()) this.drawCurve(curve);
      this.over = shape(this.svg, "g", { "clip-path": `url(#${clip})` });
      this.drawCursor();
    }

    drawRoad() {
      const { lanes } = this.figure;
      if (!lanes.length) return;
      const edges = lanes.map(([level]) => this.toY(level));
      shape(this.svg, "rect", {
        class: "road", x: this.left, y: round(Math.min(...edges)), width: this.inner.w,
        height: round(Math.max(...edges) - Math.min(...edges)),
      });
      for (const [level, solid] of lanes) {
        const d = `M${this.left} ${round(this.toY(level))}h${this.inner.w}`;
        shape(this.svg, "path", { class: solid ? "edge" : "lane", d });
      }
    }

    drawAxes(x, up) {
      const { inner } = this;
      const bottom = MARGIN.top + inner.h;
      const across = ticks(x[0], x[1], inner.w / 46);
      const lined = !this.figure.lanes.length;
      for (const value of across.found) {
        const at = round(this.toX(value));
        if (lined) shape(this.svg, "path", { class: "gridline", d: `M${at} ${MARGIN.top}v${inner.h}` });
        shape(this.svg, "text", { x: at, y: bottom + 17, "text-anchor": "middle" }, sign(value, across.digits));
      }
      for (const value of up.found) {
        const at = round(this.toY(value));
        if (lined) shape(this.svg, "path", { class: "gridline", d: `M${this.left} ${at}h${inner.w}` });
        shape(this.svg, "text", { x: this.left - 7, y: at + 4, "text-anchor": "end" }, sign(value, up.digits));
      }
      shape(this.svg, "rect", { class: "frame", x: this.left, y: MARGIN.top, width: inner.w, height: inner.h });
      const middle = this.left + inner.w / 2;
      shape(this.svg, "text", { class: "label", x: middle, y: bottom + 36, "text-anchor": "middle" }, this.figure.x_label);
      const turn = `translate(14 ${MARGIN.top + inner.h / 2}) rotate(-90)`;
      shape(this.svg, "text", { class: "label", transform: turn, "text-anchor": "middle" }, this.figure.y_label);
    }

    drawLines() {
      for (const line of this.figure.lines) {
        const at = round(this.toY(line.y));
        const d = `M${this.left} ${at}h${this.inner.w}`;
        shape(this.body, "path", { class: line.limit ? "level limit" : "level", d });
        if (!line.name) continue;
        const place = { class: "mark-text", x: this.left + this.inner.w - 5, y: at - 4, "text-anchor": "end" };
        shape(this.body, "text", place, line.name);
      }
    }

    drawEvents(x) {
      if (!this.figure.time) return;
      const mark = (time, kind) => {
        if (time < x[0] || time > x[1]) return;
        shape(this.body, "path", { class: `event ${kind}`, d: `M${round(this.toX(time))} ${MARGIN.top}v${this.inner.h}` });
      };
      for (const [time, level] of data.events) if (level !== "debug" && level !== "info") mark(time, level);
      const formed = data.formation_time;
      if (formed === null || formed <= firstTime) return;
      mark(formed, "formed");
      const place = { class: "mark-text formed-text", x: round(this.toX(formed)) + 4, y: MARGIN.top + 12 };
      shape(this.body, "text", place, "formed");
    }

    drawCurve(curve) {
      const xs = pool[curve.x];
      const ys = pool[curve.y];
      let d = "";
      let pen = "M";
      for (let index = 0; index < xs.length; index++) {
        if (xs[index] === null || ys[index] === null) {
          pen = "M";
          continue;
        }
        const px = round(this.toX(xs[index]));
        const py = round(this.toY(ys[index]));
        if (curve.points) d += `M${px} ${py}h0`;
        else d += curve.step && pen === "L" ? `H${px}V${py}` : `${pen}${px} ${py}`;
        pen = "L";
      }
      const kind = curve.points ? "curve points" : curve.dash ? "curve dash" : "curve";
      const path = shape(this.body, "path", { class: kind, d });
      path.style.stroke = ink(curve.colour);
      if (!curve.fill) return;
      const floor = round(this.toY(0));
      path.setAttribute("d", `${d}V${floor}H${round(this.toX(xs[0]))}Z`);
      path.classList.add("fill");
      path.style.fill = ink(curve.colour);
      path.style.fillOpacity = 0.35;
    }

    // The time cursor, a dot on each curve, and its value in the legend.
    drawCursor() {
      this.over.replaceChildren();
      const { time } = shared;
      if (this.figure.time && time !== null) {
        shape(this.over, "path", { class: "cursor", d: `M${round(this.toX(time))} ${MARGIN.top}v${this.inner.h}` });
      }
      const texts = {};
      this.figure.curves.forEach((curve) => {
        const index = time === null || !curve.at ? -1 : indexAt(pool[curve.at], time);
        const at = index < 0 ? null : pool[curve.y][index];
        if (index >= 0) (texts[curve.name] ??= []).push(reading(at));
        if (at === null || pool[curve.x][index] === null || this.hidden.has(curve.name)) return;
        const place = { cx: round(this.toX(pool[curve.x][index])), cy: round(this.toY(at)) };
        shape(this.over, "circle", { class: "dot", r: curve.dash ? 3 : 4, ...place }).style.fill = ink(curve.colour);
      });
      this.figure.curves.forEach((curve, number) => {
        if (this.readings[number]) this.readings[number].textContent = (texts[curve.name] ?? []).join(" | ");
      });
      if (this.brush) {
        const [from, to] = [this.brush.from, this.brush.to].map(this.toX).sort((a, b) => a - b);
        shape(this.over, "rect", { class: "brush", x: from, y: MARGIN.top, width: to - from, height: this.inner.h });
      }
    }

    place(event) {
      const box = this.svg.getBoundingClientRect();
      const scale = this.size.width / box.width;
      return { x: (event.clientX - box.left) * scale, y: (event.clientY - box.top) * scale };
    }

    // The time of the place pointed at: of the axis, or of the nearest point of a curve.
    timeAt({ x, y }) {
      if (this.figure.time) return Math.min(lastTime, Math.max(firstTime, this.fromX(x)));
      let best = null;
      let least = Infinity;
      for (const curve of this.shown()) {
        if (!curve.at) continue;
        const [xs, ys] = [pool[curve.x], pool[curve.y]];
        for (let index = 0; index < xs.length; index++) {
          if (xs[index] === null || ys[index] === null) continue;
          const distance = (this.toX(xs[index]) - x) ** 2 + (this.toY(ys[index]) - y) ** 2;
          if (distance < least) [least, best] = [distance, pool[curve.at][index]];
        }
      }
      return best;
    }

    pointed(event) {
      const time = this.timeAt(this.place(event));
      if (this.brush) this.brush.to = time;
      if (time !== null) setTime(time);
    }

    pressed(event) {
      this.pointed(event);
      if (!this.figure.time || event.pointerType !== "mouse" || event.button !== 0) return;
      this.svg.setPointerCapture(event.pointerId);
      this.brush = { from: shared.time, to: shared.time };
    }

    released() {
      if (!this.brush) return;
      const range = [this.brush.from, this.brush.to].sort((a, b) => a - b);
      this.endBrush();
      if (this.toX(range[1]) - this.toX(range[0]) > 6) setRange(range);
    }

    endBrush() {
      this.brush = null;
      this.drawCursor();
    }
  }

  const sign = (value, digits) => value.toFixed(digits).replace(/^-(0(\.0*)?)$/, "$1").replace("-", "−");

  // ---- what the figures share

  let waiting = false;

  function setTime(time) {
    shared.time = time;
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      for (const plot of plots) plot.drawCursor();
      document.getElementById("cursor").textContent = shared.time === null ? hint() : `t = ${shared.time.toFixed(2)} s`;
    });
  }

  function setRange(range) {
    shared.range = range;
    document.getElementById("reset").hidden = range === null;
    for (const plot of plots) if (plot.figure.time) plot.draw();
  }

  function hint() {
    const fine = matchMedia("(pointer: fine)").matches;
    return fine
      ? "Point at a figure to read all of them at that time; drag to look closer, double-click to go back."
      : "Touch a figure to read all of them at that time.";
  }

  // ---- the page around them

  function fillHeader() {
    document.getElementById("name").textContent = data.scenario;
    document.getElementById("description").textContent = data.description;
    const verdict = document.getElementById("verdict");
    const missed = data.metrics.filter((row) => row[3] === false && !row[4]).map((row) => row[0].toLowerCase());
    const parts = ["No platoon formed"];
    if (data.formed) parts[0] = data.formation_time > 0 ? `Formed after ${data.formation_time.toFixed(2)} s` : "Formed from the start on";
    if (!data.complete) parts.push(`the run is not complete (${data.damage || data.status})`);
    if (missed.length) parts.push(`not as asked: ${missed.join(", ")}`);
    verdict.textContent = `${parts.join("; ")}.`;
    verdict.className = data.formed && data.complete && !missed.length ? "good" : "bad";
  }

  function fillMetrics() {
    const table = element(document.getElementById("tables"), "table");
    const head = element(element(table, "thead"), "tr");
    for (const text of ["Figure", "Value", "Asked", ""]) element(head, "th", { scope: "col" }, text);
    const body = element(table, "tbody");
    for (const [name, value, asked, met] of data.metrics) {
      const row = element(body, "tr");
      element(row, "th", { scope: "row" }, name);
      element(row, "td", {}, value);
      element(row, "td", { class: "asked" }, asked);
      const mark = met === null ? ["", ""] : met ? ["✓ met", "good"] : ["✗ missed", "bad"];
      element(row, "td", { class: `mark ${mark[1]}` }, mark[0]);
    }
  }

  function fillDetails() {
    const parent = document.getElementById("details");
    const section = (title, open = false) => {
      const made = element(parent, "details", open ? { open: "" } : {});
      element(made, "summary", {}, title);
      return made;
    };
    const count = data.events.length + data.more_events;
    if (count) {
      const body = element(element(section(`Events (${count})`, true), "table"), "tbody");
      for (const [time, level, source, text] of data.events) {
        const row = element(body, "tr");
        element(row, "th", {}, `${time.toFixed(2)} s`);
        element(row, "td", {}, level);
        element(row, "td", {}, source);
        element(row, "td", {}, text);
      }
      if (data.more_events) element(element(body, "tr"), "td", { colspan: "4" }, `and ${data.more_events} more in the log`);
    }
    const facts = element(element(section("Versions, seed and how it was run"), "table"), "tbody");
    for (const [name, value] of data.facts) {
      const row = element(facts, "tr");
      element(row, "th", { scope: "row" }, name);
      element(row, "td", {}, value);
    }
    element(section("Scenario, complete"), "pre", {}, data.toml);
  }

  function fillFigures() {
    const parent = document.getElementById("figures");
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
    for (const plot of plots) plot.draw();
  }

  const percent = (share) => `${(100 * share).toFixed(1)} %`;
  const milliseconds = (time) => (time === null ? "–" : time.toFixed(time >= 99.95 ? 0 : 3));

  function fillBuses() {
    if (!data.buses.length) return;
    const parent = document.getElementById("buses");
    parent.hidden = false;
    const row = (body, cells) => {
      const made = element(body, "tr");
      for (const [tag, kind, text] of cells) element(made, tag, kind ? { class: kind } : {}, text);
    };
    const table = (under, heads) => {
      const made = element(under, "table");
      row(element(made, "thead"), heads.map((text, index) => ["th", index ? "number" : "", text]));
      return element(made, "tbody");
    };
    const all = table(parent, ["Bus", "Bit rate", "Mean load", "Busiest cycle", "at", "Worst case of the DBC"]);
    for (const bus of data.buses) {
      row(all, [
        ["th", "", bus.bus],
        ["td", "number", `${bus.bit_rate / 1000} kbit/s`],
        ["td", "number", percent(bus.mean)],
        ["td", bus.worst > 1 ? "number over" : "number", percent(bus.worst)],
        ["td", "number", `${bus.worst_at.toFixed(2)} s`],
        ["td", "number", percent(bus.most)],
      ]);
    }
    for (const bus of data.buses) {
      const made = element(parent, "details");
      const late = bus.messages.filter((message) => !message[9]).length;
      const beyond = bus.messages.filter((message) => !message[8]).length;
      const notes = [late ? `${late} slower than their period` : "", beyond ? `${beyond} beyond their bound` : ""];
      const note = notes.filter((text) => text).map((text) => `; ${text}`).join("");
      element(made, "summary", {}, `Response times on ${bus.bus} (${bus.messages.length} messages${note})`);
      const heads = ["Message", "Identifier", "Sender", "Frames", "Mean [ms]", "Worst [ms]", "Bound [ms]", "Period [ms]"];
      const body = table(made, heads);
      for (const [id, name, sender, count, mean, worst, bound, period, within, inTime] of bus.messages) {
        row(body, [
          ["th", "", name || "not in the DBC"],
          ["td", "number", id],
          ["td", "number", sender || "–"],
          ["td", "number", String(count)],
          ["td", "number", milliseconds(mean)],
          ["td", within && inTime ? "number" : "number over", milliseconds(worst)],
          ["td", "number", milliseconds(bound)],
          ["td", "number", period === null ? "–" : String(period)],
        ]);
      }
      const text = "From the wait for the bus to the end of the frame. The bound is that of Davis et al. (2007) for frames of "
        + "the greatest length, with the release jitter of this run; only faults and frames from outside go beyond it.";
      element(made, "p", { class: "caption" }, text);
    }
  }

  fillHeader();
  fillMetrics();
  fillFigures();
  fillBuses();
  fillDetails();
  setTime(null);
  document.getElementById("reset").addEventListener("click", () => setRange(null));
  let width = innerWidth;
  addEventListener("resize", () => {
    if (innerWidth === width) return;
    width = innerWidth;
    for (const plot of plots) plot.draw();
  });
  for (const [name, paper] of [["beforeprint", true], ["afterprint", false]]) {
    addEventListener(name, () => {
      printing = paper;
      for (const plot of plots) plot.draw();
    });
  }
  document.documentElement.dataset.drawn = String(plots.length);
})();
