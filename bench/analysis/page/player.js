// The player and its controls: button, time line, speed, vehicle to follow, keys.

// With reduced motion, the player advances in steps of this wall-clock time, ms.
const STEP_MS = 500;
// Delay of the animation behind the newest data of a live run, s, so that it moves smoothly.
const BEHIND_S = 0.8;

const player = {
  playing: false,
  speed: 1,
  shownAt: null,

  play() {
    const [from, to] = this.bounds();
    if (cursor.time >= to - data.road.cycle / 2 || cursor.time < from) setTime(from);
    cursor.follows = false;
    this.start();
  },

  start() {
    this.playing = true;
    this.shownAt = null;
    byId("play").textContent = "❚❚";
    byId("play").setAttribute("aria-label", "Pause");
    requestAnimationFrame((now) => this.frame(now));
  },

  pause() {
    this.playing = false;
    byId("play").textContent = "▶";
    byId("play").setAttribute("aria-label", "Play");
  },

  toggle() {
    if (!this.playing) return this.play();
    this.pause();
    takeTime(cursor.time);
  },

  // The time range that is played: the zoomed one, or all available.
  bounds() {
    const [from, to] = shownRange();
    return [from, Math.min(to, lastTime())];
  },

  frame(now) {
    if (!this.playing) return;
    const passed = this.shownAt === null ? 0 : now - this.shownAt;
    if (this.shownAt === null || !lessMotion.matches || passed >= STEP_MS) {
      this.shownAt = now;
      this.step(passed / 1000);
    }
    if (this.playing) requestAnimationFrame((next) => this.frame(next));
  },

  step(passed) {
    const [, to] = this.bounds();
    let time = cursor.time + passed * this.speed;
    if (cursor.follows) {
      // Smoothly, but never far behind.
      time = lessMotion.matches ? to : Math.max(cursor.time + passed, to - 2 * BEHIND_S);
      setTime(Math.min(time, to));
      return;
    }
    setTime(Math.min(time, to));
    if (time >= to && !data.live) this.pause();
  },
};

// ---- the time line

function showTime(time) {
  const slider = byId("scrub");
  slider.value = String(time);
  slider.setAttribute("aria-valuetext", seconds(time));
  byId("cursor").textContent = `t = ${seconds(time)}`;
  byId("newest").hidden = !data.live || cursor.follows;
}

function showTimeLine() {
  const [from, to] = wholeRange();
  const slider = byId("scrub");
  place(slider, { min: from, max: to, step: data.road.cycle });
  const svg = byId("line");
  const width = svg.clientWidth || 600;
  // The thumb's centre stays half its width away from both ends.
  const thumb = 8;
  const toX = (time) => thumb + ((time - from) / Math.max(1e-9, to - from)) * (width - 2 * thumb);
  svg.setAttribute("viewBox", `0 0 ${width} 14`);
  svg.replaceChildren();
  drawMarks(svg, [from, to], toX, { top: 2, height: 12 });
  showTime(cursor.time);
}

// ---- the state of each vehicle, below the road

// State and cause of each component from the events up to `time`: { state: "degraded", cause: "PeerLost" }.
function statesAt(run, time) {
  const states = new Map();
  for (const { time_s: first, repeats, source, kind, fields } of run.events) {
    if (first > time + 1e-9) break;
    if (kind !== "state_change" && kind !== "cause_change") continue;
    const at = repeats[indexAt(repeats, time)] ?? first;
    if (at < (states.get(source)?.at ?? -Infinity)) continue;
    states.set(source, { at, state: fields.after ?? fields.state, cause: fields.cause });
  }
  return states;
}

const PARTS = ["planner", "tracker", "actuators"];
const WORSE_STATES = ["degraded", "hold", "safe"];

// E.g. "degraded: planner (PeerLost), tracker; safe: actuators"; empty if all states are normal.
function worse(states, vehicle) {
  const parts = PARTS.map((part) => ({ part, ...states.get(`veh${vehicle}.${part}`) }));
  return WORSE_STATES.map((worst) => [worst, parts.filter(({ state }) => state === worst)])
    .filter(([, those]) => those.length)
    .map(([worst, those]) => `${worst}: ${those.map(({ part, cause }) => (cause ? `${part} (${cause})` : part)).join(", ")}`)
    .join("; ");
}

function showVehicles(time) {
  const parent = byId("vehicles");
  parent.replaceChildren();
  for (const run of runs()) {
    const states = statesAt(run, time);
    for (const vehicle of vehiclesOf(run)) {
      const chip = element(parent, "li", { class: run.prefix ? "b" : "" });
      element(chip, "i").style.background = run.road.colours[vehicle - 1];
      element(chip, "b", {}, `${vehicle}${letter(run)}`);
      const speed = valueAt(run, `${vehicle}.v_x`, time);
      element(chip, "span", { class: "speed" }, speed === null ? "–" : `${speed.toFixed(1)} m/s`);
      element(chip, "span", { class: "state" }, worse(states, vehicle));
    }
  }
}

// ---- controls

function fillFollow() {
  const select = byId("follow");
  select.replaceChildren();
  element(select, "option", { value: "0" }, "the platoon");
  for (const vehicle of vehiclesOf(data)) element(select, "option", { value: String(vehicle) }, `vehicle ${vehicle}`);
  select.value = String(animation.follow);
}

function followVehicle(vehicle) {
  animation.follow = vehicle;
  byId("follow").value = String(vehicle);
  drawAnimation();
}

function goOn() {
  cursor.follows = true;
  setTime(Math.max(cursor.time, lastTime() - BEHIND_S));
  player.start();
}

// Space plays and pauses; arrows step 0.1 s, or one cycle with Shift; Home and End; digits follow a vehicle.
function pressedKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const where = event.target;
  const typed = where.closest?.("select, textarea, input:not([type=range])");
  const pressable = where.closest?.("button, summary, a");
  if (typed || (pressable && (event.key === " " || event.key === "Enter"))) return;
  const step = event.shiftKey ? data.road.cycle : 0.1;
  const [from, to] = player.bounds();
  const moves = { ArrowLeft: cursor.time - step, ArrowRight: cursor.time + step, Home: from, End: to };
  if (event.key === " ") player.toggle();
  else if (event.key in moves) {
    player.pause();
    takeTime(moves[event.key]);
  } else if (event.key === "Escape") setRange(null);
  else if (/^\d$/.test(event.key) && Number(event.key) <= data.road.vehicles) followVehicle(Number(event.key));
  else return;
  event.preventDefault();
}

byId("play").addEventListener("click", () => player.toggle());
byId("scrub").addEventListener("input", (event) => {
  player.pause();
  takeTime(Number(event.target.value));
});
byId("speed").addEventListener("change", (event) => {
  player.speed = Number(event.target.value);
});
byId("follow").addEventListener("change", (event) => followVehicle(Number(event.target.value)));
byId("newest").addEventListener("click", goOn);
byId("reset").addEventListener("click", () => setRange(null));
addEventListener("keydown", pressedKey);
onTime.push(showTime, showVehicles);
onRange.push((range) => {
  byId("reset").hidden = range === null;
});
