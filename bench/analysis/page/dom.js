// Small helpers: elements, numbers as text.

const SVG = "http://www.w3.org/2000/svg";
const byId = (id) => document.getElementById(id);

// A line may break after a hyphen, but not within `->` or before the name of an option.
const WHOLE = /((?<=^|\s)-[-\w>]{1,24})/;

function write(made, text) {
  const parts = String(text).split(WHOLE);
  made.textContent = parts[0];
  for (const [index, part] of parts.slice(1).entries()) {
    if (index % 2) made.append(part);
    else element(made, "span", { class: "whole" }).textContent = part;
  }
}

function element(parent, tag, attributes = {}, text = null) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (text !== null) write(made, text);
  parent.append(made);
  return made;
}

function shape(parent, tag, attributes = {}, text = null) {
  const made = document.createElementNS(SVG, tag);
  place(made, attributes);
  if (text !== null) made.textContent = text;
  parent.append(made);
  return made;
}

function place(shaped, attributes) {
  for (const [name, value] of Object.entries(attributes)) shaped.setAttribute(name, value);
}

const round = (value) => Math.round(value * 10) / 10;
const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

function ink(colour) {
  if (colour === "limit") return "var(--limit)";
  return colour === "ink" ? "var(--ink)" : colour;
}

// The same on a white page.
const LIGHT = { limit: "#c8102e", ink: "#1d1f21" };
const lightInk = (colour) => LIGHT[colour] ?? colour;

// A number with a true minus sign, never "−0".
const sign = (value, digits) => value.toFixed(digits).replace(/^-(0(\.0*)?)$/, "$1").replace("-", "−");

// A value as text for the legend.
function reading(value) {
  if (value === null || value === undefined) return "–";
  const size = Math.abs(value);
  if (size < 1e-4) return size === 0 ? "0" : value.toExponential(1).replaceAll("-", "−");
  return sign(value, size >= 1000 ? 0 : size >= 10 ? 2 : size >= 1 ? 3 : 4);
}
// The length of the longest such text, in characters.
const READING = 8;

const seconds = (time) => `${time.toFixed(2)} s`;
const percent = (share) => `${(100 * share).toFixed(1)} %`;
const milliseconds = (time) => (time === null ? "–" : time.toFixed(time >= 99.95 ? 0 : 3));

// Preferences of the viewer's system.
const lessMotion = matchMedia("(prefers-reduced-motion: reduce)");
const darkColours = matchMedia("(prefers-color-scheme: dark)");
const finePointer = matchMedia("(pointer: fine)");
