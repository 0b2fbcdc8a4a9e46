// The page: keeps what the server sends, decides which time is shown, and draws when something has changed.

import { camera } from "./camera.js";
import { charts, onResize, prepare } from "./charts.js";
import { control } from "./control.js";
import { latency } from "./latency.js";
import { loop } from "./loop.js";
import { draw } from "./map.js";
import { legend, panels, stateOf } from "./panels.js";
import { ask, connect } from "./stream.js";
import { SPAN_S, timeline } from "./timeline.js";

const by = (id) => document.getElementById(id);
const COLOURS = ["back", "ink", "muted", "line", "faint", "ground", "outside", "robot", "plan", "estimate", "truth", "body", "cover", "scan", "goal", "good", "stop", "warning", "idle", "on"];
const MAX_ROWS = 3600;
const MAX_EVENTS = 300;
// A body that moves farther than this between two frames is drawn at its new place at once.
const MAX_GLIDE_M = 0.6;

const page = { system: null, frame: null, before: null, came_ms: 0, rows: [], events: [], lost: null, shown_s: null, past: null, epoch_ms: null };
let colour = {};
let isDirty = true;
let asked = 0;
let last_ms = 0;
const costs = [];

const changed = () => { isDirty = true; };
const eye = camera(by("map"), () => { followButton(); changed(); });
const show = panels(by);
const showLoop = loop(by("loop"), by("loop-note"));
const showLatency = latency(by("latency"), by("latency-note"));
const showControl = control(by("control"), by("control-form"), by("control-result"));
const showTimeline = timeline(by("timeline"), choose);

function readColours() {
  const style = getComputedStyle(document.documentElement);
  colour = Object.fromEntries(COLOURS.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  legend(by("legend"), colour);
  changed();
}

function followButton() {
  by("follow").setAttribute("aria-pressed", String(eye.follows));
}

/** Shows the frame of that time; null shows the newest. */
function choose(time_s) {
  page.shown_s = time_s;
  by("live").setAttribute("aria-pressed", String(time_s == null));
  if (time_s == null) page.past = null;
  changed();
  fetchPast();
}

// One request at a time; the time that is wanted then decides about the next.
async function fetchPast() {
  if (page.shown_s == null || asked) return;
  const row = page.rows.findLast((row) => row.time_s <= page.shown_s) ?? page.rows[0];
  if (!row || page.past?.row.number === row.number) return;
  asked = row.number;
  try {
    const response = await ask(`/frame?number=${row.number}`);
    if (response.ok && page.shown_s != null) page.past = await response.json();
  } catch { /* The stream reports a lost connection. */ }
  asked = 0;
  changed();
  if (page.past?.row.number !== row.number) return;
  fetchPast();
}

function take(rows, events) {
  const known = page.rows.at(-1)?.number ?? 0;
  page.rows.push(...rows.filter((row) => row.number > known));
  const oldest_s = (page.rows.at(-1)?.time_s ?? 0) - SPAN_S;
  const old = page.rows.findIndex((row) => row.time_s >= oldest_s);
  page.rows.splice(0, Math.max(old, page.rows.length - MAX_ROWS));
  const newest = page.events.at(-1)?.number ?? 0;
  page.events.push(...events.filter((event) => event.number > newest));
  page.events.splice(0, page.events.length - MAX_EVENTS);
  changed();
}

connect({
  open({ rows, events }) {
    // Another server counts from the start.
    if ((rows.at(-1)?.number ?? 0) < (page.rows.at(-1)?.number ?? 0)) Object.assign(page, { rows: [], events: [], frame: null });
    take(rows, events);
    Object.assign(page, { lost: null, epoch_ms: null });
  },
  lost(reason) {
    page.lost = reason;
    changed();
  },
  system(system) {
    if (system?.run_id && page.system?.run_id && system.run_id !== page.system.run_id) page.frame = page.before = null;
    page.system = system;
    page.epoch_ms ??= Date.now() - 1000 * system.time_s;
    changed();
  },
  events: (events) => take([], events),
  frame(frame) {
    page.before = page.frame;
    page.frame = frame;
    page.came_ms = performance.now();
    take([frame.row], []);
  },
  end() {},
});

// Where the bodies are drawn: they glide from frame to frame, as long as they move as bodies do.
function glide(frame, now_ms) {
  const before = page.past ? null : page.before;
  const share = Math.min(1, (now_ms - page.came_ms) / 100);
  const [pose, moves] = between(before?.pose, frame?.pose, share);
  return [pose && { ...pose, truth: between(before?.truth, frame.truth, share)[0] }, moves];
}

function between(before, pose, share) {
  if (!pose || !before) return [pose, false];
  const far = Math.hypot(pose.x_m - before.x_m, pose.y_m - before.y_m);
  if (far > MAX_GLIDE_M || share >= 1) return [pose, false];
  const turn = Math.atan2(Math.sin(pose.yaw_rad - before.yaw_rad), Math.cos(pose.yaw_rad - before.yaw_rad));
  return [{
    x_m: before.x_m + share * (pose.x_m - before.x_m),
    y_m: before.y_m + share * (pose.y_m - before.y_m),
    yaw_rad: before.yaw_rad + share * turn,
  }, true];
}

// The last minute of the run that the frame belongs to: scans count up within a run.
function trailOf(frame) {
  const until = frame?.row.time_s ?? Infinity;
  let end = page.rows.length;
  while (end > 0 && page.rows[end - 1].time_s > until) end--;
  let start = end;
  while (start > 0 && page.rows[start - 1].time_s > until - 60 && (start === end || page.rows[start - 1].scan_id <= page.rows[start].scan_id)) start--;
  return page.rows.slice(start, end);
}

let body = null;
let trail = [];
let timeline_ms = 0;
let painted = null;

function paint(now_ms) {
  requestAnimationFrame(paint);
  const started = performance.now();
  const frame = page.shown_s == null ? page.frame : page.past ?? page.frame;
  let moves;
  [body, moves] = glide(frame, now_ms);
  const course = page.system?.course ?? page.course;
  if (course) page.course = course;
  const track = course?.track?.y_m;
  const isMoving = eye.step(Math.min(0.1, (now_ms - last_ms) / 1000), body, track ? (track[0] + track[1]) / 2 : 0);
  last_ms = now_ms;
  if (!isDirty && !moves && !isMoving) return;
  const { context, width, height } = prepare(by("map"));
  if (isDirty) trail = trailOf(frame);
  draw(context, eye, { frame, course, rows: trail, body, size: { width, height } }, colour);
  if (isDirty) paintPanels(frame, course);
  isDirty = false;
  note(performance.now() - started);
}

// What changes with frames only, not with the glide between them.
function paintPanels(frame, course) {
  const newest_s = page.rows.at(-1)?.time_s ?? 0;
  const now_s = Math.max(newest_s, page.lost ? 0 : page.system?.time_s ?? 0);
  const until_s = page.shown_s ?? now_s;
  const goal = course?.goal;
  if (frame && frame !== painted) {
    const pose = frame.truth ?? frame.pose;
    frame.goal_m = pose && goal?.x_m != null ? Math.hypot(pose.x_m - goal.x_m, pose.y_m - goal.y_m) : null;
    painted = frame;
  }
  const isPast = page.shown_s != null;
  const state = isPast ? [stateOf(page.system, frame, null)[0], "Past", "Esc or Live returns to now"] : stateOf(page.system, frame, page.lost);
  show.state(state, page.system, frame);
  show.frame(frame);
  show.events(page.events, page.epoch_ms);
  showLoop(page.system);
  showLatency.frame(frame);
  showLatency.system(page.system);
  showLatency.history(page.rows, until_s, colour);
  charts(by("charts"), page.rows, course, until_s, colour);
  // Two pixels a second: it need not be drawn ten times a second.
  if (page.shown_s != null || performance.now() - timeline_ms > 400) {
    showTimeline(page.rows, page.events, now_s, page.shown_s, colour);
    timeline_ms = performance.now();
  }
  showControl(page.system?.actions ?? []);
}

// The cost of drawing, for tests: the 95th percentile of the last 300 frames [ms].
function note(cost_ms) {
  costs.push(cost_ms);
  if (costs.length < 300) return;
  document.body.dataset.paintP95Ms = costs.toSorted((one, other) => one - other)[285].toFixed(2);
  costs.length = 0;
}

by("follow").addEventListener("click", () => { eye.follows = !eye.follows; });
by("fit").addEventListener("click", fit);
by("zoom-in").addEventListener("click", () => eye.zoom(1.3));
by("zoom-out").addEventListener("click", () => eye.zoom(1 / 1.3));
by("live").addEventListener("click", () => choose(null));
by("legend-button").addEventListener("click", toggleLegend);

function fit() {
  const track = page.course?.track;
  if (!track?.x_m) return;
  const goal_x = page.course.goal?.x_m ?? track.x_m[1];
  const x = track.x_m[1] - track.x_m[0] > 60 ? [(body?.x_m ?? 0) - 10, (body?.x_m ?? 0) + 20] : [track.x_m[0], Math.max(goal_x + 1, Math.min(track.x_m[1], goal_x + 4))];
  eye.fit(x, track.y_m);
}

function toggleLegend() {
  by("legend").hidden = !by("legend").hidden;
  by("legend-button").setAttribute("aria-expanded", String(!by("legend").hidden));
}

addEventListener("keydown", (event) => {
  if (event.target.matches("input, select") || event.ctrlKey || event.metaKey || event.altKey) return;
  const action = {
    f: () => { eye.follows = !eye.follows; }, 0: fit, "+": () => eye.zoom(1.3), "-": () => eye.zoom(1 / 1.3),
    l: toggleLegend, Escape: () => choose(null),
  }[event.key];
  action?.();
});
onResize(changed);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", readColours);
readColours();
requestAnimationFrame(paint);
