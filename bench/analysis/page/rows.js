// Parts of tables: heads, rows of numbers, and the mark of a requirement.

const heading = (parent, texts) => {
  const row = element(element(parent, "thead"), "tr");
  texts.forEach((text) => element(row, "th", { scope: "col" }, text));
};

// The group of a metric (bench/analysis/requirements.py); only "run" is a verdict on the run.
const NEUTRAL = { comfort: ["within", "exceeded"], machine: ["within", "slower"] };

function markOf(met, group) {
  if (met === null) return { look: "", mark: "", word: "" };
  if (NEUTRAL[group]) return { look: "neutral", mark: met ? "✓" : "○", word: NEUTRAL[group][met ? 0 : 1] };
  return met ? { look: "good", mark: "✓", word: "met" } : { look: "bad", mark: "✗", word: "missed" };
}

const numberRow = (body, cells) => {
  const row = element(body, "tr");
  for (const [tag, kind, text] of cells) element(row, tag, kind ? { class: kind } : {}, text);
};

function numberTable(parent, heads) {
  const table = element(element(parent, "div", { class: "scrolls" }), "table");
  const row = element(element(table, "thead"), "tr");
  heads.forEach((text, index) => element(row, "th", index ? { class: "number" } : {}, text));
  return element(table, "tbody");
}
