// Text and tables: verdict, metrics, events, buses, versions, scenario.

// The letter of one of two runs with its label, or the name of its file.
const nameOf = (run) => `${letter(run)}: ${data.names[run === data ? 0 : 1]}`;

function fillHeader() {
  const titles = runs().map(({ label, scenario }) => (label ? `${label} (${scenario})` : scenario));
  byId("name").textContent = titles.join(" and ");
  byId("description").textContent = data.other ? "Two runs overlaid: A solid, B dashed." : data.description;
  const parent = byId("verdicts");
  parent.replaceChildren();
  for (const run of runs()) {
    const { text, good } = verdict(run);
    const line = element(parent, "p", { class: data.live ? "" : good ? "good" : "bad" });
    if (data.other) element(line, "span", { class: "file" }, `${nameOf(run)}: `);
    line.append(text);
  }
}

// What the two runs were started with, as far as it differs.
function fillSettings() {
  const parent = byId("settings");
  parent.hidden = !data.other;
  if (!data.other) return;
  parent.replaceChildren();
  element(parent, "h3", {}, "What differs between A and B");
  const { rows, more, notes } = data.settings;
  if (rows.length) {
    const table = element(element(parent, "div", { class: "scrolls" }), "table");
    heading(table, ["", "Setting", ...runs().map(nameOf)]);
    const body = element(table, "tbody");
    for (const [group, name, a, b] of rows) {
      const row = element(body, "tr");
      element(row, "td", { class: "asked" }, group);
      element(row, "th", { scope: "row" }, name);
      for (const value of [a, b]) element(row, "td", { class: "value" }, value);
    }
  }
  for (const note of more ? [`and ${more} more; platoon diff --json lists all`, ...notes] : notes) {
    element(parent, "p", { class: "caption" }, note);
  }
}

function verdict(run) {
  if (data.live) return { text: "The run is in progress." };
  const missed = run.metrics.filter((row) => row[3] === false && row[4] === "run").map((row) => row[0].toLowerCase());
  const parts = ["No platoon formed"];
  if (run.formed) parts[0] = run.formation_time > 0 ? `Formed after ${seconds(run.formation_time)}` : "Formed from the start";
  if (!run.complete) parts.push(`the run is not complete (${run.damage || run.status})`);
  if (missed.length) parts.push(`requirements missed: ${missed.join(", ")}`);
  return { text: `${parts.join("; ")}.`, good: run.formed && run.complete && !missed.length };
}

// The groups of metrics, each with the heading of its table; the last value of a row is its group.
const GROUPS = [["run", "Metric"], ["comfort", "Comfort"], ["machine", "On this machine"]];

function fillMetrics() {
  const parent = byId("tables");
  parent.replaceChildren();
  parent.hidden = !data.metrics.length;
  const fill = data.other ? fillCompared : fillSingle;
  const rows = data.other ? data.compared : data.metrics;
  for (const [group, title] of GROUPS) {
    const chosen = rows.filter((row) => row.at(-1) === group);
    if (chosen.length) fill(element(parent, "table"), title, chosen, group === "comfort" ? "Limit" : "Required");
  }
}

function fillSingle(table, title, rows, asks) {
  heading(table, [title, "Value", asks, ""]);
  const body = element(table, "tbody");
  for (const [name, value, asked, met, group] of rows) {
    const row = element(body, "tr");
    element(row, "th", { scope: "row" }, name);
    element(row, "td", {}, value);
    element(row, "td", { class: "asked" }, asked);
    const { look, mark, word } = markOf(met, group);
    const cell = element(row, "td", { class: `verdict ${look}` }, mark);
    if (word) element(cell, "span", {}, ` ${word}`);
  }
}

function fillNotSent() {
  const parent = byId("not-sent");
  const titles = (data.not_sent ?? []).map((title) => title.replace(/ +/g, " "));
  parent.hidden = !titles.length;
  parent.textContent = `Not drawn, because the ECUs did not send it or sent start values only: ${titles.join("; ")}.`;
}

function fillCompared(table, title, rows, asks) {
  table.className = "compared";
  heading(table, [title, "A", "B", "B − A", asks]);
  const body = element(table, "tbody");
  for (const [name, a, b, difference, askedA, askedB, metA, metB, group] of rows) {
    const row = element(body, "tr");
    element(row, "th", { scope: "row" }, name);
    for (const [value, met] of [[a, metA], [b, metB]]) {
      const cell = element(row, "td", {}, value);
      const { look, mark } = markOf(met, group);
      if (mark) element(cell, "span", { class: look }, ` ${mark}`);
    }
    element(row, "td", {}, difference);
    element(row, "td", { class: "asked" }, askedA === askedB ? askedA : `${askedA || "–"} | ${askedB || "–"}`);
  }
}

const MOST_EVENTS = 500;

function fillEvents() {
  const parent = byId("events");
  const all = runs().flatMap((run) => run.events.map((event) => ({ run: letter(run), ...event })));
  const rows = all.filter((event) => !isUsual(event)).sort((a, b) => a.time_s - b.time_s);
  const told = rows.slice(0, MOST_EVENTS);
  const more = runs().reduce((sum, run) => sum + run.more_events, 0) + all.length - told.length;
  parent.hidden = !rows.length;
  byId("event-count").textContent = `Faults and mode changes (${rows.length})`;
  const body = byId("event-rows");
  body.replaceChildren();
  for (const event of told) {
    const { run, time_s: time, level, source } = event;
    const row = element(body, "tr", { class: SERIOUS.includes(level) ? lookOf(event) : "" });
    const jump = element(element(row, "th", { scope: "row" }), "button", { class: "jump", type: "button" }, seconds(time));
    jump.addEventListener("click", () => {
      player.pause();
      takeTime(time);
    });
    element(row, "td", {}, run ? `${run} ${source}` : source);
    element(row, "td", {}, textOf(event));
  }
  if (more) element(element(body, "tr"), "td", { colspan: "3" }, `and ${more} more in the log, e.g. starts of components`);
}

function fillDetails() {
  const parent = byId("details");
  parent.replaceChildren();
  const section = (title) => {
    const made = element(parent, "details", { class: "printed" });
    element(made, "summary", {}, title);
    return made;
  };
  const values = runs().map((run) => new Map(run.facts));
  const names = new Set(values.flatMap((facts) => [...facts.keys()]));
  const table = element(section("Versions, seed and run settings"), "table");
  if (data.other) heading(table, ["", "A", "B"]);
  const body = element(table, "tbody");
  for (const name of names) {
    const row = element(body, "tr");
    element(row, "th", { scope: "row" }, name);
    const kind = values.some((facts) => facts.get(name) !== values[0].get(name)) ? { class: "differs" } : {};
    for (const facts of values) element(row, "td", kind, facts.get(name) ?? "–");
  }
  const same = data.other && data.other.toml === data.toml;
  for (const run of same ? [data] : runs()) {
    const whose = same ? ", identical in A and B" : letter(run) && ` of ${letter(run)}`;
    element(section(`Complete scenario${whose}`), "pre", {}, run.toml);
  }
}

// ---- buses

function fillBuses() {
  const parent = byId("buses");
  parent.hidden = !runs().some((run) => run.buses.length);
  const strip = byId("strip").querySelector("svg");
  byId("strip").hidden = !strip;
  if (strip && !byId("strip").querySelector(".save")) {
    const title = "The busiest cycle of each bus";
    addSaving(byId("strip-head"), title, { name: "busiest-cycle", svg: () => standalone(strip, { title }), csv: stripCsv });
  }
  const tables = byId("bus-tables");
  tables.replaceChildren();
  const all = numberTable(tables, ["Bus", "Bit rate", "Mean load", "Bound of mean", "Busiest cycle", "at"]);
  for (const run of runs()) {
    for (const bus of run.buses) {
      numberRow(all, [
        ["th", "", `${letter(run)} ${bus.bus}`],
        ["td", "number", `${bus.bit_rate / 1000} kbit/s`],
        ["td", "number", percent(bus.mean)],
        ["td", "number", percent(bus.most)],
        ["td", bus.worst > 1 ? "number over" : "number", percent(bus.worst)],
        ["td", "number", seconds(bus.worst_at)],
      ]);
    }
  }
  for (const run of runs()) for (const bus of run.buses) fillResponses(tables, bus, letter(run));
}

function fillResponses(parent, bus, run) {
  const made = element(parent, "details");
  const late = bus.messages.filter((message) => !message[9]).length;
  const beyond = bus.messages.filter((message) => !message[8]).length;
  const notes = [late ? `${late} slower than their period` : "", beyond ? `${beyond} above their bound` : ""];
  const note = notes.filter((text) => text).map((text) => `; ${text}`).join("");
  const which = run ? `${bus.bus} of ${run}` : bus.bus;
  element(made, "summary", {}, `Response times on ${which} (${bus.messages.length} messages${note})`);
  const heads = ["Message", "Identifier", "Sender", "Frames", "Mean [ms]", "Worst [ms]", "Bound [ms]", "Period [ms]"];
  const body = numberTable(made, heads);
  for (const [id, name, sender, count, mean, worst, bound, period, within, inTime] of bus.messages) {
    numberRow(body, [
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
  const text = "From release to the end of the frame. The bound is the worst-case response time of Davis et al. (2007) for frames "
    + "of maximum length, with the release jitter of this run; only faults and frames from outside can exceed it.";
  element(made, "p", { class: "caption" }, text);
}
