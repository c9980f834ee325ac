// What is shown: a run, or two laid over each other. It grows while a run goes on, and is replaced when that ends.

let data = JSON.parse(byId("data").textContent);

// The runs shown: A, and where there is one B, whose columns have names of their own.
const runs = () => (data.other ? [data, data.other] : [data]);
const column = (run, key) => data.pool[(run.prefix ?? "") + key];
const letter = (run) => (data.other ? (run === data ? "A" : "B") : "");

// What is shown of two runs laid over each other: a run, and the curves that are dashed where there is one run.
const layers = { A: true, B: true, second: !data.other };
const shownRuns = () => runs().filter((run) => !data.other || layers[letter(run)]);

function firstTime() {
  return Math.min(...runs().map((run) => column(run, "t")[0] ?? 0));
}

function lastTime() {
  return Math.max(...runs().map((run) => column(run, "t").at(-1) ?? 0));
}

// All of the time there is to show; of a run that goes on, all that is to come.
function wholeRange() {
  return [firstTime(), data.live ? Math.max(data.road.duration, lastTime()) : lastTime()];
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

// A value of a run at a time, on the straight line between its samples; null where there is none.
function valueAt(run, key, time) {
  const [times, values] = [column(run, "t"), column(run, key)];
  if (!values?.length) return null;
  const index = Math.max(0, indexAt(times, time));
  const [value, next] = [values[index], values[index + 1] ?? null];
  if (value === null || next === null || time <= times[index]) return value;
  return value + ((next - value) * (time - times[index])) / (times[index + 1] - times[index]);
}

// A vehicle of a run, from 1, at a time; null where it is not known.
function poseAt(run, vehicle, time) {
  const [X, Y, psi] = ["X", "Y", "psi"].map((name) => valueAt(run, `${vehicle}.${name}`, time));
  if (X === null || Y === null) return null;
  const steering = valueAt(run, `${vehicle}.steering`, time) ?? 0;
  return { X, Y, psi: psi ?? 0, steering, over: time > (column(run, "t").at(-1) ?? 0) + data.road.cycle };
}

const vehiclesOf = (run) => Array.from({ length: run.road.vehicles }, (_, index) => index + 1);

// Put more at the end of columns and events.
function grow({ pool = {}, events = [] }) {
  for (const [key, values] of Object.entries(pool)) (data.pool[key] ??= []).push(...values);
  data.events.push(...events);
}
