// The page: keeps what the server sends, decides which time is shown, and draws when something has changed.

import { camera } from "./camera.js";
import { charts, onResize, prepare, timeAt } from "./charts.js";
import { control } from "./control.js";
import { latency } from "./latency.js";
import { loop } from "./loop.js";
import { draw, extent, toGoal } from "./map.js";
import { legend, panels, stateOf } from "./panels.js";
import { bounds, past } from "./past.js";
import { player } from "./player.js";
import { connect, startTime } from "./link.js";
import { SPAN_S, timeline } from "./timeline.js";
import { why } from "./why.js";

const by = (id) => document.getElementById(id);
const COLOURS = ["back", "ink", "muted", "line", "faint", "ground", "outside", "robot", "plan", "estimate", "truth", "body", "cover", "scan", "goal", "good", "stop", "warning", "idle", "on"];
const MAX_ROWS = 3600;
const MAX_EVENTS = 300;
// A body that moves farther than this between two frames is drawn at its new place at once.
const MAX_GLIDE_M = 0.6;

// Rows of a recording are there from `window[0]` to `window[1]` [s]; `overview` is the whole of it, in larger steps.
const page = { system: null, frame: null, rows: [], events: [], lost: null, shown_s: null, past: null, epoch_ms: null, overview: null, window: null };
// The last step from frame to frame that bodies glide along.
let glided = { before: null, frame: null, came_ms: 0, length_ms: 100 };
let colour = {};
// The shown time that was asked about, and its scan where that is known.
let asked = { shown_s: null, scan: null };
let isDirty = true;
let last_ms = 0;
const costs = [];

const changed = () => { isDirty = true; };
const eye = camera(by("map"), () => { followButton(); changed(); }, (place) => controls.click(place));
const show = panels(by);
const showLoop = loop(by("loop"), by("loop-note"));
const showLatency = latency(by("latency"), by("latency-note"));
const controls = control(by("control"), by("control-form"), by("control-result"), by("stop"));
const showTimeline = timeline(by("timeline"), choose, askAt, askEvent);
const reasons = why(by);
const play = player(by, choose);
const fetchPast = past(page, (frame) => {
  glided = { before: play.isPlaying ? page.past : null, frame, came_ms: performance.now(), length_ms: 100 / play.speed };
  page.past = frame;
  changed();
});

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
  if (page.overview && time_s == null) return;
  page.shown_s = time_s == null ? null : Math.max(bounds(page).from_s, Math.min(bounds(page).to_s, time_s));
  by("live").setAttribute("aria-pressed", String(time_s == null));
  if (time_s == null) page.past = null;
  if (time_s == null && reasons.isOpen) reasons.set(false);
  changed();
  fetchPast();
}

/** Stays at a time, or at the shown one, and asks why the robot did what it did then. */
function askAt(time_s, scan = null) {
  const shown_s = time_s ?? page.shown_s ?? page.frame?.row.time_s;
  if (shown_s == null) return;
  play.set(false);
  if (!reasons.isOpen) reasons.set(true);
  choose(shown_s);
  asked = { shown_s: page.shown_s, scan };
}

/** Asks about an event: about the scan that it knows, else about the frame after it, which shows what it did. */
function askEvent(event) {
  if (!event) return;
  const rows = page.rows.at(0)?.time_s <= event.time_s ? page.rows : page.overview ?? page.rows;
  askAt(rows.find((row) => row.time_s >= event.time_s)?.time_s ?? event.time_s, event.scan_id);
}

const eventOf = (item) => page.events.find((event) => event.number === Number(item?.dataset.number));

// Scans count up within a run: one with a later, lower one is of an earlier run, which is over.
function followReasons() {
  if (!reasons.isOpen || page.shown_s == null || play.isPlaying || !page.past) return;
  const { time_s, scan_id } = page.past.row;
  const isOver = !page.overview && page.rows.some((row) => row.time_s > time_s && row.scan_id < scan_id);
  if (isOver) reasons.refuse("This scan is of a run that is over: ask its recording, scanloop why FILE SCAN.");
  else reasons.follow((asked.shown_s === page.shown_s ? asked.scan : null) ?? scan_id);
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
  open({ rows, events, recording }) {
    // Another server may show something else at the same address.
    if (!recording !== !page.overview) Object.assign(page, { system: null, frame: null, rows: [], events: [], shown_s: null, past: null });
    if (recording) {
      const isWhole = rows.length === recording.frames;
      Object.assign(page, { overview: rows, rows: isWhole ? rows : [], window: isWhole ? [-Infinity, Infinity] : null, events, past: null, lost: null });
      fetchPast();
      return;
    }
    page.overview = null;
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
    if (system?.run_id && page.system?.run_id && system.run_id !== page.system.run_id) page.frame = null;
    const isFirst = page.overview && !page.system;
    page.system = system;
    if (isFirst) {
      play.set(startTime == null);
      choose(startTime ?? 0);
    }
    page.epoch_ms ??= Date.now() - 1000 * system.time_s;
    changed();
  },
  events: (events) => take([], events),
  frame(frame) {
    glided = { before: page.frame, frame, came_ms: performance.now(), length_ms: 100 };
    page.frame = frame;
    take([frame.row], []);
  },
  end() {},
});

// Where the bodies are drawn: they glide from frame to frame, as long as they move as bodies do.
function glide(frame, now_ms) {
  const before = glided.frame === frame ? glided.before : null;
  const share = Math.min(1, (now_ms - glided.came_ms) / glided.length_ms);
  const [pose, moves] = between(before?.body ?? before?.pose, frame?.body ?? frame?.pose, share);
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

// The last seconds of the run that the frame belongs to, of these rows: scans count up within a run.
function trailOf(frame, rows, span_s) {
  const until = frame?.row.time_s ?? Infinity;
  let end = rows.length;
  while (end > 0 && rows[end - 1].time_s > until) end--;
  let start = end;
  while (start > 0 && rows[start - 1].time_s > until - span_s && (start === end || rows[start - 1].scan_id <= rows[start].scan_id)) start--;
  return rows.slice(start, end);
}

let shown = { frame: null, course: null };
let body = null;
let trail = [];
let painted = null;
let played_ms = 0;

function paint(now_ms) {
  requestAnimationFrame(paint);
  const started = performance.now();
  const seconds = Math.min(0.1, (now_ms - last_ms) / 1000);
  if (page.shown_s != null && play.isPlaying && !page.lost) {
    const { to_s } = bounds(page);
    const next_s = play.step(seconds, page.shown_s, to_s);
    if (next_s >= to_s) {
      choose(page.overview ? to_s : null);
    } else {
      // A new frame draws all; without one, the mark of the time moves ten times a second.
      page.shown_s = next_s;
      if (now_ms - played_ms > 100) changed();
      fetchPast();
    }
  }
  const frame = page.shown_s == null ? page.frame : page.past ?? page.frame;
  let moves;
  [body, moves] = glide(frame, now_ms);
  page.course = page.system?.course ?? page.course;
  // A frame has the goals once one of them has changed.
  const course = page.course && frame?.goals ? { ...page.course, goals: frame.goals, goal: frame.goals.at(-1) } : page.course;
  shown = { frame, course };
  const track = course?.track?.y_m;
  const centre_y = course?.way ? body?.y_m : track ? (track[0] + track[1]) / 2 : 0;
  const isMoving = eye.step(seconds, body, centre_y);
  last_ms = now_ms;
  followReasons();
  if (!isDirty && !moves && !isMoving) return;
  const { context, width, height } = prepare(by("map"));
  if (isDirty) trail = trailOf(frame, page.rows, 60);
  draw(context, eye, { frame, course, rows: trail, body, size: { width, height } }, colour);
  if (isDirty) paintPanels(frame, course);
  isDirty = false;
  note(performance.now() - started);
}

// What changes with frames only, not with the glide between them.
function paintPanels(frame, course) {
  played_ms = last_ms;
  const { from_s, to_s } = bounds(page);
  const until_s = page.shown_s ?? to_s;
  const isRecording = page.overview != null;
  // A frame of a recording brings the processes of its time.
  const system = frame?.system ? { ...page.system, ...frame.system, status: { scenario: page.system?.scenario, ...frame.system.status } } : page.system;
  if (frame && frame !== painted) {
    const pose = frame.truth ?? frame.pose;
    frame.goal_m = pose && course?.goal?.x_m != null ? toGoal(course, pose) : null;
    painted = frame;
  }
  const isPast = page.shown_s != null && !isRecording;
  const state = isPast ? [stateOf(system, frame, null)[0], "Past", "Esc or Live returns to now"] : stateOf(system, frame, page.lost);
  show.state(state, system, frame);
  show.frame(frame);
  show.events(page.events, page.shown_s ?? Infinity, isRecording ? null : page.epoch_ms);
  showLoop(system);
  showLatency.system(system);
  showLatency.frame(frame);
  showLatency.history(page.rows, until_s, colour);
  charts(by("charts"), page.rows, course, until_s, colour);
  const shown_s = page.shown_s;
  showTimeline({ rows: page.overview ?? page.rows, events: page.events, from_s, to_s, shown_s, isRecording }, colour);
  by("live").hidden = isRecording;
  play.show(shown_s == null ? null : { from_s: Math.max(0, from_s), to_s, shown_s, isRecording });
  controls.show(page.system?.actions ?? []);
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
by("why-button").addEventListener("click", toggleReasons);
by("loop").addEventListener("click", () => askAt(null));
by("charts").addEventListener("click", (event) => {
  const time_s = timeAt(by("charts"), event.offsetX);
  if (time_s != null) askAt(time_s);
});
by("events").addEventListener("click", (event) => askEvent(eventOf(event.target.closest("li"))));
by("events").addEventListener("keydown", (event) => { if (event.key === "Enter") askEvent(eventOf(event.target.closest("li"))); });

function fit() {
  const place = extent(shown.course, trailOf(shown.frame, page.overview ?? page.rows, Infinity), body);
  if (place) eye.fit(...place);
}

function toggleLegend() {
  by("legend").hidden = !by("legend").hidden;
  by("legend-button").setAttribute("aria-expanded", String(!by("legend").hidden));
}

function toggleReasons() {
  if (reasons.isOpen) reasons.set(false);
  else askAt(null);
}

// An earlier or later time; from now on only an earlier one.
function jump(seconds) {
  const { to_s } = bounds(page);
  const next_s = (page.shown_s ?? to_s) + seconds;
  choose(next_s >= to_s && !page.overview ? null : next_s);
}

addEventListener("keydown", (event) => {
  if (event.target.matches?.("input, select") || event.ctrlKey || event.metaKey || event.altKey) return;
  // A button that has the focus takes the space bar itself.
  if (event.key === " " && event.target.matches?.("button")) return;
  const step_s = event.shiftKey ? 0.1 : 1;
  const action = {
    f: () => { eye.follows = !eye.follows; }, 0: fit, "+": () => eye.zoom(1.3), "-": () => eye.zoom(1 / 1.3),
    l: toggleLegend, w: toggleReasons, Escape: () => (reasons.isOpen ? reasons.set(false) : choose(null)),
    ArrowLeft: () => jump(-step_s), ArrowRight: () => jump(step_s), PageUp: () => jump(-10), PageDown: () => jump(10),
    Home: () => choose(bounds(page).from_s), End: () => jump(Infinity), " ": play.toggle, "<": () => play.change(-1), ">": () => play.change(1),
  }[event.key];
  if (!action) return;
  if (event.key.length > 1 || event.key === " ") event.preventDefault();
  action();
});
onResize(changed);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", readColours);
readColours();
requestAnimationFrame(paint);
