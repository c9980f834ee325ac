// A car from above, to scale, on a canvas in metres; at yaw angle 0 it points to the right.

// Windows: start from the tail and length, as fractions of the car's length.
const PANES = [[0.62, 0.13], [0.12, 0.09]];

// `ghost`: only outlines, for the second of two runs.
function drawCar(context, pose, road, { colour, glass, tyre, ghost, pixel }) {
  const { front, rear, width } = road.body;
  context.save();
  context.translate(pose.X, -pose.Y);
  context.rotate(-pose.psi);
  if (pose.over) context.globalAlpha = 0.35;
  drawWheels(context, pose.steering, road, ghost ? colour : tyre, ghost ? pixel : 0);
  context.beginPath();
  context.roundRect(-rear, -width / 2, front + rear, width, width * 0.3);
  if (ghost) {
    context.setLineDash([5 * pixel, 3 * pixel]);
    context.lineWidth = 1.6 * pixel;
    context.strokeStyle = colour;
    context.stroke();
  } else {
    context.fillStyle = colour;
    context.fill();
    context.fillStyle = glass;
    const length = front + rear;
    for (const [start, share] of PANES) {
      context.fillRect(-rear + length * start, -width * 0.36, length * share, width * 0.72);
    }
  }
  context.restore();
}

// The front wheels are turned by the steering angle; half of each wheel protrudes from the body, to be visible.
function drawWheels(context, steering, road, colour, outline) {
  const [length, breadth] = road.wheel;
  road.axles.forEach((x, axle) => {
    for (const side of [-1, 1]) {
      context.save();
      context.translate(x, side * (road.body.width / 2));
      if (axle === 0) context.rotate(-steering);
      context.beginPath();
      context.rect(-length / 2, -breadth / 2, length, breadth);
      if (outline) {
        context.lineWidth = outline;
        context.strokeStyle = colour;
        context.stroke();
      } else {
        context.fillStyle = colour;
        context.fill();
      }
      context.restore();
    }
  });
}

// The target position of a planner, as an outline on the road.
function drawSlot(context, X, Y, road, colour, pixel) {
  const { front, rear, width } = road.body;
  context.save();
  context.globalAlpha = 0.75;
  context.setLineDash([3 * pixel, 3 * pixel]);
  context.lineWidth = 1.3 * pixel;
  context.strokeStyle = colour;
  context.strokeRect(X - rear, -Y - width / 2, front + rear, width);
  context.restore();
}
