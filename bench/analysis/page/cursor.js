// The time that is shown everywhere, and the range of time that figures show.

const cursor = {
  // s; always in the run.
  time: firstTime(),
  // What is zoomed to, s; null for all of the run.
  range: null,
  // Whether it goes along with a run that goes on, until somebody takes it.
  follows: Boolean(data.live),
};

const onTime = [];
const onRange = [];
let announced = false;

function setTime(time) {
  cursor.time = clamp(time, firstTime(), lastTime());
  if (announced) return;
  announced = true;
  requestAnimationFrame(() => {
    announced = false;
    for (const tell of onTime) tell(cursor.time);
  });
}

// The same, by hand.
function takeTime(time) {
  cursor.follows = false;
  setTime(time);
}

function setRange(range) {
  cursor.range = range;
  for (const tell of onRange) tell(range);
}

const shownRange = () => cursor.range ?? wholeRange();
