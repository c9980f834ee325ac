// The page of a campaign. Its figures have no time, so that the player stands still.

const player = { playing: false, pause() {} };

function numbersTable(parent, heads, rows) {
  const made = numberTable(parent, heads);
  for (const row of rows) numberRow(made, row.map((text, index) => [index ? "td" : "th", index ? "number" : "", text]));
  return made;
}

function fillTitle() {
  byId("name").textContent = data.scenario;
  byId("description").textContent = data.description;
  for (const { text, good } of data.verdicts) {
    element(byId("verdicts"), "p", { class: good === null ? "" : good ? "good" : "bad" }, text);
  }
}

function fillChoices() {
  const parent = byId("choices");
  parent.hidden = !data.choices.length;
  element(parent, "h3", {}, "Share of runs that failed, by choice");
  const rows = data.choices.map(([name, value, ...cells]) => [`${name} = ${value}`, ...cells]);
  numbersTable(parent, ["Input and value", "Failed", "Of", "Share", "95 % bounds"], rows);
}

function fillRequirements() {
  const parent = byId("requirements");
  element(parent, "h3", {}, "Share of failures");
  numbersTable(parent, ["Requirement", "Failed", "Of", "Share", "95 % bounds"], data.shares);
  for (const note of data.notes) element(parent, "p", { class: "caption" }, note);
}

function fillWorst() {
  const parent = byId("worst");
  for (const { requirement, metric, runs: worst } of data.worst) {
    element(parent, "h3", {}, requirement);
    const body = numberTable(parent, ["Run", metric, "Requirement", "Wall time", "Report"]);
    for (const { number, value, met, wall, report, log } of worst) {
      const row = element(body, "tr");
      element(row, "th", { scope: "row" }, number);
      element(row, "td", { class: "number" }, value);
      const { look, mark, word } = markOf(met, "run");
      element(row, "td", { class: `number ${look}` }, word ? `${mark} ${word}` : "–");
      element(row, "td", { class: "number" }, wall);
      const cell = element(row, "td", { class: "number" });
      if (report) element(cell, "a", { href: report }, "report");
      else cell.append(log ? `platoon report ${log}` : "log not kept");
    }
  }
  if (!data.worst.length) element(parent, "p", { class: "caption" }, "No requirement names a metric that the runs have.");
}

function fillTroubles() {
  const parent = byId("troubles");
  parent.hidden = !data.troubles.length;
  if (parent.hidden) return;
  element(parent, "h3", {}, "Runs that did not end");
  const body = numberTable(parent, ["Status", "Runs", "First", "What was said"]);
  body.parentElement.querySelector("th:last-child").className = "";
  for (const [status, count, first, words] of data.troubles) {
    numberRow(body, [["th", "", status], ["td", "number", count], ["td", "number", first], ["td", "words", words]]);
  }
}

// A figure that depends on choices: `made(parent, choice)` returns what is drawn, with `card` and `draw`.
function selectable(parent, choices, made) {
  const box = element(parent, "div", { class: "chosen" });
  const bar = element(box, "div", { class: "choice" });
  const body = element(box, "div");
  let shownNow = null;
  const show = () => {
    if (shownNow) {
      observer.unobserve(shownNow.card);
      plots.splice(plots.indexOf(shownNow), 1);
    }
    body.replaceChildren();
    shownNow = made(body, Object.fromEntries(selects.map(({ id, select }) => [id, select.value])));
    plots.push(shownNow);
    shownNow.draw();
    observer.observe(shownNow.card);
  };
  const selects = choices.map(({ id, label, options }) => {
    const select = element(element(bar, "label", {}, `${label} `), "select", { id });
    for (const option of options) element(select, "option", { value: option }, option);
    select.addEventListener("change", show);
    return { id, select };
  });
  show();
}

const blank = (id, title, more) => ({
  id, title, caption: "", curves: [], lines: [], time: false, wide: false, y_range: [], y_top: null, x_range: [], lanes: [], ...more,
});

const dots = (name, x, y, colour) => ({ name, x, y, colour, dash: false, at: "", step: false, fill: false, points: true, label: "" });

// A metric over an input, the runs that failed in another colour.
function scatterOf(metric, input) {
  const limits = data.limits[metric] ?? [];
  const [xs, ys] = [data.points.inputs[input], data.points.metrics[metric]];
  const kinds = [["met", "Completed, all met", "#0072b2"], ["failed", "Failed", "limit"]];
  kinds.forEach(([key], failed) => {
    const those = xs.map((_, index) => index).filter((index) => data.points.failed[index] === failed);
    data.pool[`scatter.${key}.x`] = those.map((index) => xs[index]);
    data.pool[`scatter.${key}.y`] = those.map((index) => ys[index]);
  });
  return blank("scatter", `${metric} over ${input}`, {
    x_label: input,
    y_label: metric,
    caption: [data.points.caption, ...limits.map((line) => `Line: ${line.name}.`)].join(" "),
    // Their names would be hidden by the points.
    lines: limits.map((line) => ({ ...line, name: "" })),
    curves: kinds.map(([key, name, colour]) => dots(name, `scatter.${key}.x`, `scatter.${key}.y`, colour)),
  });
}

function fillChosen() {
  const inputs = Object.keys(data.points.inputs);
  const metrics = Object.keys(data.points.metrics);
  const driven = Object.keys(data.influences);
  const drives = byId("drives");
  if (driven.length) {
    const choice = { id: "tornado-metric", label: "Metric", options: driven };
    selectable(drives, [choice], (parent, now) => new Tornado(parent, data.influences[now["tornado-metric"]]));
  } else {
    element(drives, "p", { class: "caption" }, data.no_influences);
  }
  if (inputs.length && metrics.length) {
    const choices = [
      { id: "scatter-metric", label: "Metric", options: metrics },
      { id: "scatter-input", label: "Input", options: inputs },
    ];
    selectable(drives, choices, (parent, now) => new Plot(parent, scatterOf(now["scatter-metric"], now["scatter-input"])));
  }
  // Those without a requirement first: the others have a figure of their own below.
  const below = new Set(data.figures.map((figure) => figure.title));
  const any = Object.keys(data.distributions).sort((a, b) => below.has(a) - below.has(b));
  if (any.length) {
    const choice = { id: "distribution-metric", label: "Metric", options: any };
    selectable(drives, [choice], (parent, now) => {
      // The same figure may stand above, with an id of its own.
      const figure = data.distributions[now["distribution-metric"]];
      return new Plot(parent, { ...figure, id: `any-${figure.id}` });
    });
  }
}

function fillMore() {
  const parent = byId("details");
  const section = (title) => {
    const made = element(parent, "details", { class: "printed" });
    element(made, "summary", {}, title);
    return made;
  };
  numbersTable(section("All metrics"), ["Metric", "Least", "5 %", "Median", "95 %", "Largest", "Runs"], data.quantiles);
  element(section("Study"), "pre", {}, data.toml);
}

let sizedFor = innerWidth;
addEventListener("resize", () => {
  if (innerWidth === sizedFor) return;
  sizedFor = innerWidth;
  drawPlots("all");
});

fillTitle();
fillRequirements();
fillChoices();
fillWorst();
fillTroubles();
makePlots(byId("figures"));
fillChosen();
fillMore();
document.documentElement.dataset.drawn = String(plots.length);
