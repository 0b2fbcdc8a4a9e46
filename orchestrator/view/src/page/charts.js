// Speed, steering and clearance over the last minute, with their bounds.

const SPAN_S = 60;
// Labels stand left of the charts [px].
const LEFT = 140;
let drawn_s = null;

// To ask for the size of an element costs a layout of the page, so it is asked for when it changes only.
const sizes = new WeakMap();
const observer = new ResizeObserver((entries) => {
  for (const { target } of entries) sizes.set(target, [target.clientWidth, target.clientHeight]);
  for (const changed of watchers) changed();
});
const watchers = new Set();

/** Calls a function when the size of a canvas has changed. */
export function onResize(changed) {
  watchers.add(changed);
}

/** Width and height of a canvas in CSS pixels. */
export function sizeOf(canvas) {
  if (!sizes.has(canvas)) {
    sizes.set(canvas, [canvas.clientWidth, canvas.clientHeight]);
    observer.observe(canvas);
  }
  return sizes.get(canvas);
}

/** A canvas at the resolution of the screen; its context, and its size in CSS pixels. */
export function prepare(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = sizeOf(canvas);
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, width, height };
}

/** The next of 1, 2, 5, 10, 20, ... that is not below. */
export function niceAbove(value) {
  if (!(value > 0)) return 1;
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5, 10].map((factor) => factor * power).find((nice) => nice >= value * 0.9999);
}

/** The time at a place of the charts, `null` beside them [s]. */
export function timeAt(canvas, x) {
  const share = (x - LEFT) / (canvas.clientWidth - LEFT);
  return drawn_s == null || share < 0 ? null : drawn_s - SPAN_S * (1 - share);
}

/** Draws the three charts: `rows` are those of the frames, `until_s` is the right end. */
export function charts(canvas, rows, course, until_s, colour) {
  const { context, width, height } = prepare(canvas);
  drawn_s = until_s;
  context.clearRect(0, 0, width, height);
  const seen = rows.filter((row) => row.time_s > until_s - SPAN_S && row.time_s <= until_s);
  const speed = course?.bounds?.velocity_max_mps ?? 1;
  const reverse = Math.min(0, ...seen.map((row) => row.speed_mps ?? 0));
  const steering = course?.bounds?.steering_max_rad ?? 0.06;
  const each = (height - 8) / 3;
  const strips = [
    { name: "speed", unit: "m/s", low: reverse * 1.15, high: speed * 1.15, bounds: [speed], ticks: [0, speed], digits: 2, thin: "desired_velocity_mps", thick: "speed_mps", style: colour.plan },
    { name: "steering", unit: "rad", low: -steering * 1.25, high: steering * 1.25, bounds: [steering, -steering], ticks: [-steering, 0, steering], digits: 3, thick: "desired_steering_rad", style: colour.plan },
    { name: "clearance, margin", unit: "m", low: 0, high: 1.5, bounds: [], ticks: [0, 1], digits: 2, thin: "margin_m", thick: "clearance_m", style: colour.body },
  ];
  strips.forEach((strip, index) => draw(context, seen, strip, { top: index * (each + 4), each, width, until_s }, colour));
}

function draw(context, rows, strip, { top, each, width, until_s }, colour) {
  const { low, high, digits } = strip;
  const left = LEFT;
  const y = (value) => top + each * (1 - (Math.min(high, Math.max(low, value)) - low) / (high - low));
  const x = (time_s) => left + (width - left) * (1 - (until_s - time_s) / SPAN_S);
  context.fillStyle = colour.back;
  context.fillRect(left, top, width - left, each);
  // Times of blocked wheels are shaded.
  context.fillStyle = colour.stop;
  context.globalAlpha = 0.14;
  rows.forEach((row, index) => {
    if (row.blocked !== 1) return;
    const end = Math.min(rows[index + 1]?.time_s ?? row.time_s + 0.1, row.time_s + 0.5);
    context.fillRect(x(row.time_s), top, x(end) - x(row.time_s) + 0.2, each);
  });
  context.globalAlpha = 1;
  context.strokeStyle = colour.idle;
  context.setLineDash([4, 4]);
  context.lineWidth = 1;
  for (const bound of strip.bounds) level(context, left, width, y(bound));
  context.setLineDash([]);
  context.strokeStyle = colour.line;
  for (const tick of strip.ticks) if (!strip.bounds.includes(tick)) level(context, left, width, y(tick));
  if (strip.thin) curve(context, rows, strip.thin, x, y, colour.muted, 1.2);
  curve(context, rows, strip.thick, x, y, strip.style, 2);
  context.fillStyle = colour.muted;
  context.font = "10px system-ui, sans-serif";
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const tick of strip.ticks) {
    const label = `${+tick.toPrecision(3)} ${strip.unit}`;
    context.fillText(label, left - 4, Math.min(top + each - 5, Math.max(top + 5, y(tick))));
  }
  context.textAlign = "left";
  context.textBaseline = "alphabetic";
  const last = rows.at(-1)?.[strip.thick];
  context.fillStyle = colour.muted;
  context.font = "11px system-ui, sans-serif";
  context.fillText(strip.name, 0, top + 12);
  context.fillStyle = colour.ink;
  context.font = "600 18px system-ui, sans-serif";
  context.fillText(last == null ? "–" : (Math.abs(last) < 0.0005 ? 0 : last).toFixed(digits), 0, top + 31);
}

function level(context, left, width, y) {
  context.beginPath();
  context.moveTo(left, y);
  context.lineTo(width, y);
  context.stroke();
}

function curve(context, rows, key, x, y, style, wide) {
  context.strokeStyle = style;
  context.lineWidth = wide;
  context.lineJoin = "round";
  context.beginPath();
  let before = null;
  for (const row of rows) {
    if (row[key] == null) { before = null; continue; }
    const isNew = before == null || row.time_s - before > 1;
    if (isNew) context.moveTo(x(row.time_s), y(row[key])); else context.lineTo(x(row.time_s), y(row[key]));
    before = row.time_s;
  }
  context.stroke();
}
