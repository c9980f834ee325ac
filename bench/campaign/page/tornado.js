// The influence of each input on a metric: bars with their confidence intervals, the strongest first.

const ROW = 26;
const BAR = 14;
// Rank correlations nearer to 0 than this are no direction.
const NO_DIRECTION = 0.1;
const DIRECTIONS = [
  { text: "rises with it", colour: "#0072b2", holds: (value) => value > NO_DIRECTION },
  { text: "falls with it", colour: "#d55e00", holds: (value) => value < -NO_DIRECTION },
  { text: "neither", colour: "#8a8a8a", holds: () => true },
];

const directionOf = (value) => DIRECTIONS.find((each) => each.holds(value));

class Tornado {
  constructor(parent, influences) {
    this.influences = influences;
    this.card = element(parent, "section", { class: "card", id: "tornado" });
    const title = `What drives ${influences.metric}`;
    const head = element(this.card, "div", { class: "head" });
    element(head, "h3", {}, title);
    const caption = `PAWN indices with 95 % confidence intervals, from ${influences.runs} runs. Left of the dashed line an influence cannot be told from chance.`;
    const used = DIRECTIONS.filter((each) => influences.inputs.some((input) => directionOf(input.direction) === each));
    const legend = used.map(({ text, colour }) => ({ text, colour, dash: false }));
    const csvRows = () => [
      ["input", "PAWN index", "half width of the 95 % interval", "rank correlation"],
      ...influences.inputs.map((input) => [input.input, input.index, input.half_width, input.direction]),
    ];
    const svgFile = () => standalone(this.svg, { title, legend, caption });
    addSaving(head, title, { name: `tornado-${influences.metric}`, svg: svgFile, csv: () => csv(csvRows()) });
    const keys = element(this.card, "div", { class: "keys" });
    for (const { text, colour } of legend) {
      const key = element(keys, "span", { class: "key" });
      element(key, "i").style.borderColor = colour;
      key.append(text);
    }
    this.svg = shape(this.card, "svg", { class: "plot", role: "img", "aria-label": title });
    element(this.card, "p", { class: "caption" }, caption);
    this.visible = true;
    this.figure = { time: false };
    this.draw();
  }

  draw() {
    const { inputs, chance } = this.influences;
    const width = printing ? PAPER.narrow : Math.max(240, this.card.clientWidth - 28);
    const longest = Math.max(...inputs.map((input) => input.input.length));
    const left = Math.min(width * 0.5, longest * CHARACTER + 12);
    const bottom = MARGIN.top + inputs.length * ROW;
    const height = bottom + MARGIN.bottom;
    const most = Math.max(chance, ...inputs.map((input) => input.index + input.half_width)) * 1.04;
    const toX = (value) => left + (clamp(value, 0, most) / most) * (width - left - MARGIN.right);
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.svg.replaceChildren();
    const across = ticks(0, most, (width - left) / 60);
    for (const value of across.found) {
      const at = round(toX(value));
      shape(this.svg, "path", { class: "gridline", d: `M${at} ${MARGIN.top}V${bottom}` });
      shape(this.svg, "text", { x: at, y: bottom + 17, "text-anchor": "middle" }, sign(value, across.digits));
    }
    inputs.forEach((input, row) => {
      const y = MARGIN.top + row * ROW + ROW / 2;
      const name = shape(this.svg, "text", { x: left - 8, y: y + 4, "text-anchor": "end" }, input.input);
      name.style.fill = "var(--ink)";
      const end = toX(input.index);
      const bar = { x: left, y: y - BAR / 2, width: round(Math.max(0.5, end - left)), height: BAR, class: "influence" };
      shape(this.svg, "rect", bar).style.fill = directionOf(input.direction).colour;
      const [low, high] = [input.index - input.half_width, input.index + input.half_width].map((value) => round(toX(value)));
      shape(this.svg, "path", { class: "whisker", d: `M${low} ${y}H${high}M${low} ${y - 4}v8M${high} ${y - 4}v8` });
    });
    shape(this.svg, "path", { class: "chance", d: `M${round(toX(chance))} ${MARGIN.top}V${bottom}` });
    const label = { class: "label", x: (left + width) / 2, y: bottom + 36, "text-anchor": "middle" };
    shape(this.svg, "text", label, "PAWN index");
  }

  drawCursor() {}
}
