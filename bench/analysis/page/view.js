// What part of the road the animation shows: a function of the time alone, so that going back shows the same again.

const VIEW = {
  // Pixels for a metre: never fewer, so that cars can be told apart; never more.
  least: 4.5,
  most: 26,
  // Road to see around the platoon, and ahead of and behind one vehicle, m.
  around: 7,
  ahead: 24,
  // Beside the road, m.
  beside: 1.6,
};

// Middle in m, pixels a metre and half of the width in m of the view at `time`, `follow` being 0 for the platoon.
function viewAt(time, width, height, follow) {
  const poses = runs().flatMap((run) => vehiclesOf(run).map((vehicle) => poseAt(run, vehicle, time))).filter(Boolean);
  const edges = data.road.edges.map(([level]) => level);
  const across = [...edges, ...poses.flatMap(({ Y }) => [Y - 1, Y + 1])];
  const [low, high] = [Math.min(...across) - VIEW.beside, Math.max(...across) + VIEW.beside];
  const followed = follow ? poseAt(data, follow, time) : null;
  const along = poses.map(({ X }) => X);
  let [from, to] = poses.length ? [Math.min(...along) - VIEW.around, Math.max(...along) + VIEW.around] : [-20, 20];
  if (followed) [from, to] = [followed.X - VIEW.ahead, followed.X + VIEW.ahead];
  const scale = clamp(Math.min(width / (to - from), height / (high - low)), VIEW.least, VIEW.most);
  const half = width / scale / 2;
  // Where not all can be seen, those at the head are.
  const X = (from + to) / 2 + Math.max(0, (to - from) / 2 - half);
  return { X, Y: (low + high) / 2, scale, half };
}
