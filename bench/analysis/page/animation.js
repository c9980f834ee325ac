// A canvas with the vehicles on the road from above, at the time of the cursor.

const TRAIL_S = 2.5;
const TRAIL_STEP = 4;
const DASH = { length: 3, gap: 6 };
const POSTS_M = 10;

const animation = {
  canvas: byId("road"),
  // The vehicle in the centre of the view; 0 for the platoon.
  follow: 0,
  visible: true,
  colours: {},
};

function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["verge", "asphalt", "marking", "ink", "soft", "glass", "tyre", "card"]) {
    animation.colours[name] = style.getPropertyValue(`--${name}`).trim();
  }
}

function drawAnimation() {
  const { canvas, colours, follow } = animation;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (!width || !animation.visible) return;
  const density = Math.min(2, devicePixelRatio || 1);
  if (canvas.width !== Math.round(width * density) || canvas.height !== Math.round(height * density)) {
    [canvas.width, canvas.height] = [Math.round(width * density), Math.round(height * density)];
  }
  const { time } = cursor;
  const view = viewAt(time, width, height, follow);
  const context = canvas.getContext("2d");
  context.setTransform(density, 0, 0, density, 0, 0);
  context.fillStyle = colours.verge;
  context.fillRect(0, 0, width, height);
  const toPixels = ({ X, Y }) => ({ x: (X - view.X) * view.scale + width / 2, y: (view.Y - Y) * view.scale + height / 2 });
  context.save();
  context.translate(width / 2, height / 2);
  context.scale(view.scale, view.scale);
  context.translate(-view.X, view.Y);
  drawGround(context, view);
  for (const run of shownRuns().reverse()) drawRun(context, run, time, view);
  context.restore();
  drawNumbers(context, time, toPixels, width);
  drawScale(context, view, width);
}

function drawGround(context, view) {
  const { colours } = animation;
  const { edges } = data.road;
  const [from, to] = [view.X - view.half - 1, view.X + view.half + 1];
  const levels = edges.map(([level]) => level);
  const [low, high] = [Math.min(...levels), Math.max(...levels)];
  context.fillStyle = colours.asphalt;
  context.fillRect(from, -high - 0.4, to - from, high - low + 0.8);
  context.strokeStyle = colours.marking;
  context.lineWidth = 0.13;
  for (const [level, solid] of edges) {
    context.setLineDash(solid ? [] : [DASH.length, DASH.gap]);
    // Dashes are fixed to the road.
    context.lineDashOffset = from - Math.floor(from / (DASH.length + DASH.gap)) * (DASH.length + DASH.gap);
    context.beginPath();
    context.moveTo(from, -level);
    context.lineTo(to, -level);
    context.stroke();
  }
  context.setLineDash([]);
  context.lineWidth = 1.2 / view.scale;
  context.strokeStyle = colours.soft;
  context.beginPath();
  for (let X = Math.ceil(from / POSTS_M) * POSTS_M; X < to; X += POSTS_M) {
    context.moveTo(X, -low + 0.4);
    context.lineTo(X, -low + 0.9);
  }
  context.stroke();
}

function drawRun(context, run, time, view) {
  const { colours } = animation;
  const ghost = Boolean(run.prefix);
  const pixel = 1 / view.scale;
  const poses = vehiclesOf(run).map((vehicle) => poseAt(run, vehicle, time));
  poses.forEach((pose, index) => {
    if (!pose) return;
    const [vehicle, colour] = [index + 1, run.road.colours[index]];
    drawTrail(context, run, vehicle, time, { colour, ghost, pixel });
    const [X, Y] = ["X", "Y"].map((axis) => valueAt(run, `${vehicle}.target.${axis}`, time));
    if (X !== null && Y !== null && !ghost) drawSlot(context, X, Y, run.road, colour, pixel);
  });
  poses.forEach((pose, index) => {
    if (!pose) return;
    const colour = run.road.colours[index];
    drawCar(context, pose, run.road, { colour, glass: colours.glass, tyre: colours.tyre, ghost, pixel });
  });
}

function drawTrail(context, run, vehicle, time, { colour, ghost, pixel }) {
  const [times, X, Y] = [column(run, "t"), column(run, `${vehicle}.X`), column(run, `${vehicle}.Y`)];
  const last = indexAt(times, time);
  const pose = poseAt(run, vehicle, time);
  context.save();
  context.strokeStyle = colour;
  context.globalAlpha = 0.65;
  context.lineWidth = 2.4 * pixel;
  if (ghost) context.setLineDash([4 * pixel, 4 * pixel]);
  context.beginPath();
  for (let index = Math.max(0, indexAt(times, time - TRAIL_S)); index <= last; index += TRAIL_STEP) {
    context.lineTo(X[index], -Y[index]);
  }
  context.lineTo(pose.X, -pose.Y);
  context.stroke();
  context.restore();
}

// Each vehicle's number on it; outside the view, an arrow at the border with the distance.
function drawNumbers(context, time, toPixels, width) {
  context.textAlign = "center";
  context.textBaseline = "middle";
  // Beside a ghost, because another car may cover it.
  const metre = toPixels({ X: 1, Y: 0 }).x - toPixels({ X: 0, Y: 0 }).x;
  const aside = (data.road.body.width / 2) * metre + 9;
  for (const run of shownRuns().reverse()) {
    for (const vehicle of vehiclesOf(run)) {
      const pose = poseAt(run, vehicle, time);
      if (!pose) continue;
      const { x, y } = toPixels(pose);
      const name = `${vehicle}${run.prefix ? "B" : ""}`;
      const colour = run.road.colours[vehicle - 1];
      context.font = "700 12px system-ui, sans-serif";
      if (x < 0 || x > width) {
        const far = Math.round((x < 0 ? -x : x - width) / metre);
        const text = x < 0 ? `◀ ${name}, ${far} m` : `${name}, ${far} m ▶`;
        context.textAlign = x < 0 ? "left" : "right";
        outlined(context, text, x < 0 ? 6 : width - 6, y, colour);
        context.textAlign = "center";
      } else if (run.prefix) outlined(context, name, x, y + aside, colour);
      else outlined(context, name, x, y, "#fff", colour);
    }
  }
}

function outlined(context, text, x, y, fill, edge = animation.colours.card) {
  context.lineJoin = "round";
  context.lineWidth = 3.5;
  context.strokeStyle = edge;
  context.strokeText(text, x, y);
  context.fillStyle = fill;
  context.fillText(text, x, y);
}

function drawScale(context, view, width) {
  const { colours } = animation;
  const length = POSTS_M * view.scale;
  context.strokeStyle = context.fillStyle = colours.soft;
  context.lineWidth = 2;
  context.setLineDash([]);
  context.beginPath();
  context.moveTo(width - 12 - length, 20);
  context.lineTo(width - 12, 20);
  context.stroke();
  context.font = "12px system-ui, sans-serif";
  context.textBaseline = "bottom";
  context.fillText(`${POSTS_M} m`, width - 12 - length / 2, 18);
  context.textBaseline = "middle";
}

new IntersectionObserver((entries) => {
  animation.visible = entries.at(-1).isIntersecting;
  drawAnimation();
}, { rootMargin: "100px" }).observe(animation.canvas);

darkColours.addEventListener("change", () => {
  readColours();
  drawAnimation();
});
readColours();
onTime.push(drawAnimation);
