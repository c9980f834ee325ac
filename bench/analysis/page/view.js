// The section of road shown by the animation: a function of time only, so that rewinding shows the same view.

const VIEW = {
  // Limits of pixels per metre; the lower one keeps cars distinguishable.
  least: 4.5,
  most: 26,
  // Visible road around the platoon, and ahead of and behind a followed vehicle, m.
  around: 7,
  ahead: 24,
  // Margin beside the road, m.
  beside: 1.6,
};

// Centre in m, pixels per metre and half the width in m of the view at `time`; `follow` is 0 for the platoon.
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
  // If not all vehicles fit, the head of the platoon is shown.
  const X = (from + to) / 2 + Math.max(0, (to - from) / 2 - half);
  return { X, Y: (low + high) / 2, scale, half };
}
