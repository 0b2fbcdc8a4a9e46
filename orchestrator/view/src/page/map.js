// The map: everything the loop knows, to scale, in the plane of the track.

import { obstacle, robot, segment } from "./bodies.js";
import { niceAbove } from "./charts.js";

const TAU = 2 * Math.PI;
const SECTOR_BEAMS = 11;
// Unseen sectors are shown up to this distance, the range of the scanner.
const RANGE_M = 4;

/** Draws the parts of a view on a canvas: a frame, the course, the rows so far. */
export function draw(context, camera, view, colour) {
  const { frame, course, rows, body } = view;
  const { width, height } = view.size;
  context.clearRect(0, 0, width, height);
  context.fillStyle = colour.outside;
  context.fillRect(0, 0, width, height);
  const pen = { context, camera, colour, at: (x, y) => camera.toScreen(x, y), scale: camera.scale };
  ground(pen, course, width, height);
  (course?.goals ?? []).filter((one) => one.x_m != null).forEach((one) => goal(pen, one, course.way ? null : rows));
  if (frame) {
    unseen(pen, frame, body, course);
    paths(pen, rows);
    (frame.obstacles ?? []).forEach((item) => obstacle(pen, item, direction(course?.way, item)));
    plan(pen, frame, course);
    scan(pen, frame, course);
    if (body) robot(pen, frame, body, course);
  }
  scaleBar(pen, width, height);
}

function ground({ context, at, colour, scale }, course, width, height) {
  if (course?.way) {
    way({ context, at, colour, scale }, course.way, width, height);
    return;
  }
  const track = course?.track;
  if (track?.x_m) {
    const [left, top] = at(track.x_m[0], track.y_m[1]);
    const [right, bottom] = at(track.x_m[1], track.y_m[0]);
    context.fillStyle = colour.ground;
    context.fillRect(left, top, right - left, bottom - top);
    grid(context, at, colour, scale, width, height, track.y_m[0]);
    context.strokeStyle = track.walls ? colour.ink : colour.idle;
    context.lineWidth = track.walls ? 4 : 1.5;
    context.setLineDash(track.walls ? [] : [7, 6]);
    for (const y of [top, bottom]) segment(context, left, y, right, y);
    context.setLineDash([]);
    context.lineWidth = 1;
    for (const x of [left, right]) segment(context, x, top, x, bottom);
  } else {
    grid(context, at, colour, scale, width, height);
  }
}

// The way of a course: its ground, its bounds, and the course itself.
function way({ context, at, colour, scale }, { centre, left, right }, width, height) {
  const path = (points) => {
    context.beginPath();
    points.forEach(([x, y], index) => (index ? context.lineTo(...at(x, y)) : context.moveTo(...at(x, y))));
  };
  path([...left, ...right.toReversed()]);
  context.fillStyle = colour.ground;
  context.fill();
  grid(context, at, colour, scale, width, height);
  context.strokeStyle = colour.idle;
  context.lineWidth = 1.5;
  path([...left, ...right.toReversed(), left[0]]);
  context.stroke();
  context.setLineDash([7, 6]);
  path(centre);
  context.stroke();
  context.setLineDash([]);
}

function grid(context, at, colour, scale, width, height, below) {
  const step = Math.max(0.5, niceAbove(55 / scale));
  const [x0, y0] = at(0, 0);
  // Below the track, or at the lower edge of the map.
  const labels = Math.min(height - 6, Math.max(14, at(0, below ?? -Infinity)[1] + 15));
  context.strokeStyle = colour.faint;
  context.fillStyle = colour.muted;
  context.lineWidth = 1;
  context.font = "11px system-ui, sans-serif";
  const first = Math.ceil(-x0 / (step * scale));
  for (let k = first; x0 + k * step * scale < width; k++) {
    const x = Math.round(x0 + k * step * scale) + 0.5;
    segment(context, x, 0, x, height);
    context.fillText(`${+(k * step).toFixed(1)}`, x + 3, labels);
  }
  const lowest = Math.ceil((y0 - height) / (step * scale));
  for (let k = lowest; y0 - k * step * scale > 0; k++) {
    const y = Math.round(y0 - k * step * scale) + 0.5;
    segment(context, 0, y, width, y);
    context.fillText(`${+(k * step).toFixed(1)}`, 4, y - 3);
  }
}

function goal({ context, at, scale, colour }, goal, rows) {
  const [x, y] = at(goal.x_m, goal.y_m);
  if (rows) {
    // The line that the robot follows.
    const start = rows.find((row) => row.x_m != null);
    context.strokeStyle = colour.idle;
    context.setLineDash([2, 6]);
    context.lineWidth = 1.5;
    const [from] = at(Math.min(0, start?.x_m ?? 0), goal.y_m);
    segment(context, from, y, x, y);
    context.setLineDash([]);
  }
  context.strokeStyle = colour.goal;
  context.fillStyle = colour.goal;
  context.lineWidth = 2;
  context.beginPath();
  context.arc(x, y, Math.max(5, (goal.tolerance_m ?? 0.1) * scale), 0, TAU);
  context.globalAlpha = 0.18;
  context.fill();
  context.globalAlpha = 1;
  context.stroke();
  context.beginPath();
  context.arc(x, y, 2.5, 0, TAU);
  context.fill();
}

/** How far the next goal is from a pose: along the way of a course where there is one [m]. */
export function toGoal({ goals, way }, pose) {
  const [from_m, to_m] = way?.along_m ?? [];
  const along_m = way ? from_m + (to_m - from_m) * nearest(way, pose) / (way.centre.length - 1) : pose.x_m;
  const next = goals.find((goal) => along_m <= goal.along_m + goal.tolerance_m) ?? goals.at(-1);
  return way ? Math.abs(next.along_m - along_m) : Math.hypot(pose.x_m - next.x_m, pose.y_m - next.y_m);
}

/** Bounds of what matters, in x and y: the course up to its last goal, the robot and its path; null where there is none. */
export function extent(course, rows, body) {
  const { goals = [], way, track, body: size } = course ?? {};
  const length = size?.length_m ?? 0;
  const known = (place) => place?.x_m != null;
  const places = [...goals, ...rows].filter(known).map((place) => [place.x_m, place.y_m]);
  if (known(body)) for (const add of [-length, length]) places.push([body.x_m + add, body.y_m + add]);
  if (way) {
    const [from_m, to_m] = way.along_m;
    const last_m = Math.max(...goals.map((goal) => goal.along_m));
    const count = Math.ceil((way.centre.length - 1) * (last_m - from_m) / (to_m - from_m)) + 1;
    places.push(...way.left.slice(0, count), ...way.right.slice(0, count));
  }
  if (!places.length) return null;
  const [x, y] = [0, 1].map((axis) => places.map((place) => place[axis])).map((all) => [Math.min(...all), Math.max(...all)]);
  // The bounds beside the way, where they are not farther than the scanner sees.
  const beside = track?.y_m ?? y;
  return [x, [Math.min(y[0], Math.max(beside[0], y[0] - RANGE_M)), Math.max(y[1], Math.min(beside[1], y[1] + RANGE_M))]];
}

// The index of the point of a way that is nearest to a place.
function nearest({ centre }, place) {
  const far = centre.map(([x, y]) => Math.hypot(place.x_m - x, place.y_m - y));
  return far.indexOf(Math.min(...far));
}

// The direction of the way beside a place; on a track its own.
function direction(way, place) {
  if (!way) return 0;
  const index = Math.min(nearest(way, place), way.centre.length - 2);
  const [[x0, y0], [x1, y1]] = way.centre.slice(index, index + 2);
  return Math.atan2(y1 - y0, x1 - x0);
}

function unseen({ context, at, scale, colour }, frame, body, course) {
  const sectors = frame.scanner?.unseen_sectors ?? [];
  if (!body || !frame.scan || !sectors.length) return;
  const place = scanner(body, course);
  const [x, y] = at(place.x_m, place.y_m);
  const { first_beam_yaw_rad: first, pitch_rad: pitch } = frame.scan;
  context.fillStyle = colour.stop;
  context.globalAlpha = 0.09;
  context.beginPath();
  for (const sector of sectors) {
    const from = place.yaw_rad + first + sector * SECTOR_BEAMS * pitch;
    context.moveTo(x, y);
    context.arc(x, y, RANGE_M * scale, -from, -(from + SECTOR_BEAMS * pitch), true);
  }
  context.fill();
  context.globalAlpha = 1;
}

function scanner(body, course) {
  const { x_m: along = 0, y_m: across = 0, yaw_rad: yaw = 0 } = course?.scanner ?? {};
  const [sin, cos] = [Math.sin(body.yaw_rad), Math.cos(body.yaw_rad)];
  return { x_m: body.x_m + cos * along - sin * across, y_m: body.y_m + sin * along + cos * across, yaw_rad: body.yaw_rad + yaw };
}

function paths({ context, at, colour }, rows) {
  const line = (x, y, style, dash) => {
    context.strokeStyle = style;
    context.lineWidth = 2;
    context.setLineDash(dash);
    context.lineJoin = "round";
    context.beginPath();
    let before = null;
    for (const row of rows) {
      if (row[x] == null) continue;
      const [px, py] = at(row[x], row[y]);
      // A new run starts elsewhere.
      const jumps = before && (row.scan_id < before.scan_id || Math.abs(row[x] - before[x]) > 1);
      if (!before || jumps) context.moveTo(px, py); else context.lineTo(px, py);
      before = row;
    }
    context.stroke();
    context.setLineDash([]);
  };
  line("true_x_m", "true_y_m", colour.truth, []);
  line("x_m", "y_m", colour.estimate, [5, 4]);
}

function plan({ context, at, scale, colour }, frame, course) {
  const nodes = frame.command?.plan ?? [];
  if (nodes.length < 2 || frame.command.kind === "stop") return;
  const margin = Object.values(frame.command.margin_m).reduce((sum, part) => sum + part, 0);
  const width = course?.body?.width_m ?? 0.4;
  context.strokeStyle = colour.plan;
  context.lineJoin = "round";
  context.lineCap = "butt";
  const path = () => {
    context.beginPath();
    nodes.forEach(([x, y], index) => {
      const [px, py] = at(x, y);
      if (index) context.lineTo(px, py); else context.moveTo(px, py);
    });
  };
  for (const [across, alpha] of [[width + 2 * margin, 0.1], [width, 0.12]]) {
    context.lineWidth = Math.max(1, across * scale);
    context.globalAlpha = alpha;
    path();
    context.stroke();
  }
  context.globalAlpha = 1;
  context.lineWidth = 2.5;
  path();
  context.stroke();
  context.fillStyle = colour.plan;
  for (const [x, y] of nodes) {
    const [px, py] = at(x, y);
    context.beginPath();
    context.arc(px, py, 2.6, 0, TAU);
    context.fill();
  }
}

function scan({ context, at, colour }, frame, course) {
  const pose = frame.pose;
  if (!frame.scan || !pose || frame.scan.missing) return;
  const place = scanner(pose, course);
  const { first_beam_yaw_rad: first, pitch_rad: pitch } = frame.scan;
  context.fillStyle = colour.scan;
  ranges(frame.scan).forEach((range, beam) => {
    if (range < 20) return;
    const yaw = place.yaw_rad + first + beam * pitch;
    const [x, y] = at(place.x_m + range * 1e-3 * Math.cos(yaw), place.y_m + range * 1e-3 * Math.sin(yaw));
    context.fillRect(x - 1.2, y - 1.2, 2.4, 2.4);
  });
}

const decoded = new WeakMap();

/** The ranges of a scan [mm]. */
function ranges(scan) {
  let values = decoded.get(scan);
  if (!values) {
    const bytes = Uint8Array.from(atob(scan.ranges_mm_base64), (letter) => letter.charCodeAt(0));
    const view = new DataView(bytes.buffer);
    values = Uint16Array.from({ length: bytes.length / 2 }, (_, beam) => view.getUint16(2 * beam, true));
    decoded.set(scan, values);
  }
  return values;
}

function scaleBar({ context, scale, colour }, width, height) {
  const metres = niceAbove(70 / scale);
  // On a phone the lower edge belongs to the events.
  const [right, y] = width < 600 ? [16 + metres * scale, 28] : [width - 16, height - 16];
  context.strokeStyle = colour.ink;
  context.fillStyle = colour.ink;
  context.lineWidth = 2;
  segment(context, right - metres * scale, y, right, y);
  context.font = "12px system-ui, sans-serif";
  context.fillText(metres < 1000 ? `${+metres.toFixed(3)} m` : `${metres / 1000} km`, right - metres * scale, y - 6);
}
