// Saving a figure as it is shown, as SVG or PNG, or its data as CSV. Everything is made in the page.

const PNG_SCALE = 2;
const PAD = 10;
const LINE = 17;
// Average width of a character of legend and caption, in pixels.
const LETTER = 6.6;
const STYLES = [
  "fill", "fill-opacity", "font-family", "font-size", "font-weight", "opacity", "paint-order", "stroke", "stroke-dasharray",
  "stroke-linecap", "stroke-linejoin", "stroke-opacity", "stroke-width", "text-anchor",
];

// ---- CSV

const csvCell = (value) => {
  const text = value === null || value === undefined ? "" : String(value);
  return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
};

const csv = (rows) => `${rows.map((row) => row.map(csvCell).join(",")).join("\n")}\n`;

// Each column of a figure's data once: times, x and y of its curves.
function columnsOf(figure) {
  const found = new Map();
  const add = (key, head) => found.has(key) || found.set(key, head);
  for (const curve of figure.curves) {
    const who = [curve.run, curve.label || curve.name].filter(Boolean).join(" ");
    if (curve.at) add(curve.at, [curve.run, "time [s]"].filter(Boolean).join(" "));
    add(curve.x, `${who}: ${figure.x_label}`);
    add(curve.y, `${who}: ${figure.y_label}`);
  }
  return found;
}

function figureCsv(figure) {
  const columns = columnsOf(figure);
  const values = [...columns.keys()].map((key) => data.pool[key]);
  const rows = Array.from({ length: Math.max(...values.map((each) => each.length)) }, (_, index) =>
    values.map((each) => each[index]),
  );
  return csv([[...columns.values()], ...rows]);
}

function stripCsv() {
  const rows = data.buses.flatMap((bus) => bus.busiest.map((frame) => [bus.bus, ...frame]));
  return csv([["bus", "message", "identifier", "sender", "released [ms]", "start [ms]", "end [ms]"], ...rows]);
}

// ---- SVG and PNG

// The elements below `shown`, copied with the styles that they have on a white page.
function styledCopy(shown) {
  const copy = shown.cloneNode(true);
  document.documentElement.classList.add("saving");
  const copies = copy.querySelectorAll("*");
  shown.querySelectorAll("*").forEach((original, index) => {
    const style = getComputedStyle(original);
    for (const name of STYLES) copies[index].style.setProperty(name, style.getPropertyValue(name));
  });
  document.documentElement.classList.remove("saving");
  for (const extra of copy.querySelectorAll(".over, .hit, style")) extra.remove();
  for (const each of copy.querySelectorAll("[class]")) each.removeAttribute("class");
  return copy;
}

// Words in lines of at most `width` pixels.
function wrapped(words, width) {
  const lines = [[]];
  let used = 0;
  for (const word of words) {
    const size = word.width ?? (word.text.length + 1) * LETTER;
    if (used + size > width && lines.at(-1).length) {
      lines.push([]);
      used = 0;
    }
    lines.at(-1).push({ ...word, at: used });
    used += size;
  }
  return lines.filter((line) => line.length);
}

// A file of its own: title, legend, the figure, caption, on white.
function standalone(shown, { title, legend = [], caption = "" }) {
  const [, , width, height] = shown.getAttribute("viewBox").split(" ").map(Number);
  const keys = wrapped(legend.map((key) => ({ ...key, width: 36 + key.text.length * LETTER })), width);
  const words = wrapped(caption.split(" ").filter(Boolean).map((text) => ({ text })), width);
  const top = PAD + LINE + 6 + keys.length * LINE;
  const whole = { width: width + 2 * PAD, height: top + height + words.length * LINE + PAD };
  const file = document.createElementNS(SVG, "svg");
  place(file, { ...whole, viewBox: `0 0 ${whole.width} ${whole.height}`, "font-family": "system-ui, sans-serif", "font-size": 12.5 });
  shape(file, "rect", { ...whole, fill: "#fff" });
  shape(file, "text", { x: PAD, y: PAD + 12, "font-weight": 600, "font-size": 15, fill: "#1d1f21" }, title);
  keys.forEach((line, row) => {
    for (const key of line) {
      const y = PAD + (row + 2) * LINE;
      const dash = key.dash ? { "stroke-dasharray": "5 4" } : {};
      shape(file, "path", { d: `M${PAD + key.at} ${y - 4}h18`, stroke: key.colour, "stroke-width": 2.5, ...dash });
      shape(file, "text", { x: PAD + key.at + 24, y, fill: "#1d1f21" }, key.text);
    }
  });
  const drawing = shape(file, "g", { transform: `translate(${PAD} ${top})` });
  drawing.append(...styledCopy(shown).childNodes);
  words.forEach((line, row) => {
    const text = line.map((word) => word.text).join(" ");
    shape(file, "text", { x: PAD, y: top + height + (row + 1) * LINE - 4, fill: "#62666b" }, text);
  });
  return { text: new XMLSerializer().serializeToString(file), ...whole };
}

function download(name, content) {
  const link = element(document.body, "a", { href: URL.createObjectURL(content), download: name, hidden: "" });
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

function downloadPng(name, svg) {
  const image = new Image();
  image.addEventListener("load", () => {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [svg.width * PNG_SCALE, svg.height * PNG_SCALE].map(Math.round);
    canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
    canvas.toBlob((blob) => download(name, blob), "image/png");
  });
  image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(svg.text)}`;
}

// Buttons that save: `saved` has the name of the files, and functions that return the SVG and the CSV.
function addSaving(parent, title, saved) {
  const buttons = element(parent, "span", { class: "save", role: "group", "aria-label": `Save ${title}` });
  const file = (suffix) => {
    const runsOf = runs().map((run) => run.scenario).join("-and-");
    return `${`${runsOf}-${saved.name}`.replace(/[^A-Za-z0-9._-]+/g, "-")}.${suffix}`;
  };
  const kinds = {
    svg: () => download(file("svg"), new Blob([saved.svg().text], { type: "image/svg+xml" })),
    png: () => downloadPng(file("png"), saved.svg()),
    csv: () => download(file("csv"), new Blob([saved.csv()], { type: "text/csv" })),
  };
  for (const [kind, save] of Object.entries(kinds)) {
    const attributes = { type: "button", title: `Save as ${kind.toUpperCase()}`, "aria-label": `Save ${title} as ${kind.toUpperCase()}` };
    element(buttons, "button", attributes, kind.toUpperCase()).addEventListener("click", save);
  }
}
