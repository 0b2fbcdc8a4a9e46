// Bodies on the map: obstacles with their covers, and the robot with its covariance.

const TAU = 2 * Math.PI;

/** An obstacle; its ellipse lies along a course that has this direction there. */
export function obstacle({ context, at, scale, colour }, item, direction = 0) {
  const [x, y] = at(item.x_m, item.y_m);
  const isRemembered = item.unseen_s > 0;
  context.lineWidth = 1.5;
  context.strokeStyle = colour.cover;
  context.fillStyle = colour.cover;
  context.beginPath();
  // The robot's centre keeps out of the ellipse, its body out of the box: only the box is filled.
  context.ellipse(x, y, item.a_m * scale, item.b_m * scale, -direction, 0, TAU);
  context.globalAlpha = isRemembered ? 0.65 : 1;
  context.setLineDash(isRemembered ? [4, 4] : []);
  context.stroke();
  const [bx, by, length, width, yaw] = item.box;
  const [px, py] = at(bx, by);
  context.save();
  context.translate(px, py);
  context.rotate(-yaw);
  const [l, w] = [Math.max(4, length * scale), Math.max(4, width * scale)];
  context.fillStyle = colour.body;
  if (!isRemembered) context.fillRect(-l / 2, -w / 2, l, w);
  context.strokeStyle = colour.body;
  context.strokeRect(-l / 2, -w / 2, l, w);
  context.restore();
  context.setLineDash([]);
  context.globalAlpha = 1;
  const speed = Math.hypot(item.velocity_x_mps, item.velocity_y_mps);
  if (speed > 0.05) arrow(context, at(bx, by), at(bx + item.velocity_x_mps, by + item.velocity_y_mps), colour.ink);
  context.fillStyle = colour.ink;
  context.font = "600 11px system-ui, sans-serif";
  const label = speed > 0.05 ? `${item.id} · ${speed.toFixed(1)} m/s` : `${item.id}`;
  context.fillText(label, x + 3, y - item.b_m * scale - 5);
}

function arrow(context, [x0, y0], [x1, y1], style) {
  const yaw = Math.atan2(y1 - y0, x1 - x0);
  context.strokeStyle = style;
  context.fillStyle = style;
  context.lineWidth = 2;
  segment(context, x0, y0, x1, y1);
  context.beginPath();
  context.moveTo(x1 + 4 * Math.cos(yaw), y1 + 4 * Math.sin(yaw));
  for (const turn of [2.6, -2.6]) context.lineTo(x1 + 7 * Math.cos(yaw + turn), y1 + 7 * Math.sin(yaw + turn));
  context.fill();
}

export function robot({ context, at, scale, colour }, frame, body, course) {
  const { length_m: length = 0.56, width_m: width = 0.4 } = course?.body ?? {};
  const outline = (pose, paint) => {
    const [x, y] = at(pose.x_m, pose.y_m);
    context.save();
    context.translate(x, y);
    context.rotate(-pose.yaw_rad);
    paint(Math.max(4, (length * scale) / 2), Math.max(3, (width * scale) / 2));
    context.restore();
  };
  const isBlocked = frame.row.blocked === 1;
  if (frame.pose) covariance(context, at, scale, colour, frame.pose, body);
  outline(body, (l, w) => {
    context.fillStyle = isBlocked ? colour.stop : colour.robot;
    context.beginPath();
    context.roundRect(-l, -w, 2 * l, 2 * w, Math.min(5, w / 2));
    context.fill();
    context.fillStyle = colour.on;
    context.beginPath();
    context.moveTo(l * 0.72, 0);
    context.lineTo(l * 0.2, w * 0.55);
    context.lineTo(l * 0.2, -w * 0.55);
    context.fill();
    // The centre.
    context.beginPath();
    context.arc(0, 0, Math.min(3, w / 3), 0, TAU);
    context.fill();
  });
  if (body.truth) {
    outline(body.truth, (l, w) => {
      context.strokeStyle = colour.truth;
      context.lineWidth = 1.5;
      context.strokeRect(-l, -w, 2 * l, 2 * w);
    });
  }
}

// The region in which the robot's centre is with 95 % probability.
function covariance(context, at, scale, colour, pose, body) {
  const [xx, xy, yy] = pose.covariance_m2;
  const mean = (xx + yy) / 2;
  const radius = Math.hypot((xx - yy) / 2, xy);
  const axes = [mean + radius, mean - radius].map((value) => 2.448 * Math.sqrt(Math.max(0, value)) * scale);
  const [x, y] = at(body.x_m, body.y_m);
  context.strokeStyle = context.fillStyle = colour.estimate;
  context.lineWidth = 1;
  context.beginPath();
  context.ellipse(x, y, Math.max(1, axes[0]), Math.max(1, axes[1]), -Math.atan2(2 * xy, xx - yy) / 2, 0, TAU);
  context.globalAlpha = 0.08;
  context.fill();
  context.globalAlpha = 0.6;
  context.stroke();
  context.globalAlpha = 1;
}

/** A line. */
export function segment(context, x0, y0, x1, y1) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}
