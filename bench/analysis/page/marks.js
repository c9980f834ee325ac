// Marks of faults and mode changes on the time axes, and the text that a mark shows when pointed at.

const SERIOUS = ["warning", "error", "fatal"];
// Marks closer than this, in pixels, are merged.
const APART = 9;
const LINES_OF_TIP = 8;

// Whether an event only reports the start of a component, or is for debugging.
function isUsual({ kind, level, fields }) {
  const before = { state_change: fields.before, cause_change: fields.state }[kind];
  const starts = ["init", "wait"].includes(before);
  return level === "debug" || (level === "info" && starts);
}

// How an event is drawn: as a fault, or by its level.
const lookOf = ({ kind, level }) => (["fault_begins", "fault_ends"].includes(kind) ? "fault" : level);

// The text of an event; a change that recurred has how often and until when.
const textOf = ({ text, repeats }) =>
  repeats.length ? `${text}, ${repeats.length + 1} times until ${seconds(repeats.at(-1))}` : text;

// The other events: time, text and look.
function eventMarks() {
  const found = [];
  for (const run of runs()) {
    for (const event of run.events) {
      if (isUsual(event)) continue;
      const { time_s: time, source } = event;
      found.push({ time, look: lookOf(event), text: says(run, time, source, textOf(event)) });
    }
    if (run.formation_time > firstTime()) {
      found.push({ time: run.formation_time, look: "formed", text: says(run, run.formation_time, "", "formed") });
    }
  }
  return found.sort((a, b) => a.time - b.time);
}

const says = (run, time, source, text) => `${[letter(run), seconds(time), source].filter(Boolean).join(" ")}: ${text}`;

// Time spans with an active fault; one that does not end lasts to the end of the run.
function faultSpans() {
  const spans = [];
  for (const run of runs()) {
    const open = new Map();
    for (const { time_s: time, kind, fields } of run.events) {
      const which = JSON.stringify([fields.fault, fields.parameters]);
      if (kind === "fault_begins") {
        const span = { start: time, end: Infinity };
        open.set(which, span);
        spans.push(span);
      } else if (kind === "fault_ends" && open.has(which)) {
        open.get(which).end = time;
        open.delete(which);
      }
    }
  }
  return spans;
}

const GRAVITY = ["info", "formed", "warning", "fault", "error", "fatal"];

// Overlapping marks merged into one: position, all their texts, and the look of the most severe.
function clusters(range, toX) {
  const found = [];
  for (const mark of eventMarks()) {
    if (mark.time < range[0] || mark.time > range[1]) continue;
    const at = toX(mark.time);
    const last = found.at(-1);
    if (last && at - last.at < APART) {
      last.texts.push(mark.text);
      if (GRAVITY.indexOf(mark.look) > GRAVITY.indexOf(last.look)) last.look = mark.look;
    } else found.push({ at, time: mark.time, look: mark.look, texts: [mark.text] });
  }
  return found;
}

// Draw spans and marks at the top of a figure of this `height`: a wedge each, with its text when pointed at.
function drawMarks(parent, range, toX, { top, height }) {
  for (const { start, end } of faultSpans()) {
    if (end < range[0] || start > range[1]) continue;
    const [from, to] = [toX(Math.max(start, range[0])), toX(Math.min(end, range[1]))];
    shape(parent, "rect", { class: "span", x: round(from), y: top, width: round(Math.max(1, to - from)), height });
  }
  for (const { at, time, look, texts } of clusters(range, toX)) {
    const group = shape(parent, "g", { class: `mark ${look}` });
    if (["formed", "error", "fatal"].includes(look)) {
      shape(group, "path", { class: "event", d: `M${round(at)} ${top}v${height}` });
    }
    shape(group, "path", { class: "wedge", d: `M${round(at)} ${top + 9}l-4.5 -9h9z` });
    // A finger needs more room than the wedge has.
    const hit = shape(group, "rect", { class: "hit", x: round(at) - 8, y: top - 4, width: 16, height: 20 });
    hit.addEventListener("pointerenter", (event) => event.pointerType === "mouse" && showTip(hit, texts));
    hit.addEventListener("pointerleave", (event) => event.pointerType === "mouse" && hideTip());
    hit.addEventListener("pointerdown", (event) => event.stopPropagation());
    hit.addEventListener("click", (event) => {
      event.stopPropagation();
      takeTime(time);
      showTip(hit, texts);
    });
  }
}

function showTip(marked, texts) {
  const tip = byId("tip");
  const more = texts.length - LINES_OF_TIP;
  tip.replaceChildren();
  for (const text of texts.slice(0, LINES_OF_TIP)) element(tip, "p", {}, text);
  if (more > 0) element(tip, "p", {}, `and ${more} more`);
  tip.hidden = false;
  const [box, own] = [marked.getBoundingClientRect(), tip.getBoundingClientRect()];
  tip.style.left = `${clamp(box.left + box.width / 2 - own.width / 2, 6, document.documentElement.clientWidth - own.width - 6)}px`;
  tip.style.top = `${box.top - own.height - 6 > 50 ? box.top - own.height - 6 : box.bottom + 8}px`;
}

function hideTip() {
  byId("tip").hidden = true;
}

addEventListener("pointerdown", hideTip);
addEventListener("scroll", hideTip, { passive: true });
