// The data shown: one run, or two overlaid. During a live run it grows; when the run ends, it is replaced.

let data = JSON.parse(byId("data").textContent);

// The runs shown: A and, if there is one, B, whose columns have prefixed names.
const runs = () => (data.other ? [data, data.other] : [data]);
const column = (run, key) => data.pool[(run.prefix ?? "") + key];
const letter = (run) => (data.other ? (run === data ? "A" : "B") : "");

// Visible layers of two overlaid runs: each run, and the curves that are dashed for a single run.
const layers = { A: true, B: true, second: !data.other };
const shownRuns = () => runs().filter((run) => !data.other || layers[letter(run)]);

function firstTime() {
  return Math.min(...runs().map((run) => column(run, "t")[0] ?? 0));
}

function lastTime() {
  return Math.max(...runs().map((run) => column(run, "t").at(-1) ?? 0));
}

// The whole time range; of a live run, up to its planned end.
function wholeRange() {
  return [firstTime(), data.live ? Math.max(data.road.duration, lastTime()) : lastTime()];
}

// Index of the last of the ascending `times` that is not after `time`; -1 before the first.
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

// A value of a run at a time, linearly interpolated; null if there is none.
function valueAt(run, key, time) {
  const [times, values] = [column(run, "t"), column(run, key)];
  if (!values?.length) return null;
  const index = Math.max(0, indexAt(times, time));
  const [value, next] = [values[index], values[index + 1] ?? null];
  if (value === null || next === null || time <= times[index]) return value;
  return value + ((next - value) * (time - times[index])) / (times[index + 1] - times[index]);
}

// The pose of a vehicle (from 1) of a run at a time; null if unknown.
function poseAt(run, vehicle, time) {
  const [X, Y, psi] = ["X", "Y", "psi"].map((name) => valueAt(run, `${vehicle}.${name}`, time));
  if (X === null || Y === null) return null;
  const steering = valueAt(run, `${vehicle}.steering`, time) ?? 0;
  return { X, Y, psi: psi ?? 0, steering, over: time > (column(run, "t").at(-1) ?? 0) + data.road.cycle };
}

const vehiclesOf = (run) => Array.from({ length: run.road.vehicles }, (_, index) => index + 1);

// Append to columns and events.
function grow({ pool = {}, events = [] }) {
  for (const [key, values] of Object.entries(pool)) (data.pool[key] ??= []).push(...values);
  data.events.push(...events);
}
