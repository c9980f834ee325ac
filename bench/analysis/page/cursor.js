// The time shown everywhere, and the time range of the figures.

const cursor = {
  // s; always within the run.
  time: firstTime(),
  // The zoomed range, s; null for the whole run.
  range: null,
  // Whether it follows the newest time of a live run, until the user moves it.
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

// Set the time by user input.
function takeTime(time) {
  cursor.follows = false;
  setTime(time);
}

function setRange(range) {
  cursor.range = range;
  for (const tell of onRange) tell(range);
}

const shownRange = () => cursor.range ?? wholeRange();
