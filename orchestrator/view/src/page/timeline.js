// A time axis: where the wheels were blocked, how fast the robot was, what happened, and which time is shown.

import { prepare, sizeOf } from "./charts.js";
import { clock } from "./player.js";

export const SPAN_S = 300;
const TOP = 4;
const BAND = 26;
// What moves two pixels a second need not be drawn ten times a second.
const PAUSE_MS = 400;
// A pointer that moves less is a click, and an event is as wide.
const MAX_CLICK_PX = 6;
const STEPS_S = [1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600, 7200, 21600];

/** The axis; calls `choose` with a time [s], `ask` with one of blocked wheels and `askEvent` with an event that was clicked. */
export function timeline(canvas, choose, ask, askEvent) {
  let range = null;
  let shown = null;
  let pressed = null;
  let drawn = { key: "", at_ms: -Infinity };
  const band = document.createElement("canvas");

  const timeAt = (event) => {
    const share = Math.min(1, Math.max(0, event.offsetX / canvas.clientWidth));
    return range.from_s + share * (range.to_s - range.from_s);
  };
  canvas.addEventListener("pointerdown", (event) => {
    if (!range) return;
    canvas.setPointerCapture(event.pointerId);
    pressed = event.offsetX;
    choose(timeAt(event));
  });
  canvas.addEventListener("pointerup", (event) => {
    if (pressed == null || Math.abs(event.offsetX - pressed) > MAX_CLICK_PX) return;
    const time_s = timeAt(event);
    const near_s = MAX_CLICK_PX * (range.to_s - range.from_s) / canvas.clientWidth;
    const distance = (one) => Math.abs(one.time_s - time_s);
    const near = shown.events.filter((one) => one.kind !== "info" && distance(one) < near_s);
    const nearest = near.sort((one, other) => distance(one) - distance(other))[0];
    if (nearest) return askEvent(nearest);
    if (shown.rows.findLast((row) => row.time_s <= time_s)?.blocked === 1) ask(time_s);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (range && event.buttons) choose(timeAt(event));
  });

  // What has happened is drawn once and copied; the mark of the shown time moves above it.
  function drawBand(view, colour) {
    const { rows, events, from_s, to_s, isRecording } = view;
    const [width, height] = sizeOf(canvas);
    const ratio = window.devicePixelRatio || 1;
    Object.assign(band, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    const context = band.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const x = (time_s) => (width * (time_s - from_s)) / (to_s - from_s);
    context.fillStyle = colour.back;
    context.fillRect(0, TOP, width, BAND);
    // Rows of a long recording stand for some frames each.
    const longest_s = isRecording ? Math.max(0.5, 2 * (to_s - from_s) / Math.max(1, rows.length)) : 0.5;
    rows.forEach((row, index) => {
      const next = rows[index + 1]?.time_s ?? row.time_s + 0.1;
      const length = x(Math.min(next, row.time_s + longest_s)) - x(row.time_s);
      const share = row.blocked ? 1 : Math.min(1, Math.abs(row.speed_mps ?? 0));
      context.fillStyle = [colour.robot, colour.stop, colour.idle][row.blocked];
      context.globalAlpha = [0.75, 0.35, 0.18][row.blocked];
      context.fillRect(x(row.time_s), TOP + BAND * (1 - share), length + 0.3, BAND * share);
    });
    context.globalAlpha = 1;
    const styles = { bad: colour.stop, warning: colour.warning, good: colour.good };
    for (const event of events) {
      if (!styles[event.kind] || event.time_s < from_s) continue;
      context.fillStyle = styles[event.kind];
      context.beginPath();
      context.moveTo(x(event.time_s) - 4, 0);
      context.lineTo(x(event.time_s) + 4, 0);
      context.lineTo(x(event.time_s), 8);
      context.fill();
    }
  }

  // Labels of the axis, but for those that the label of the mark would cover.
  function drawLabels(context, { from_s, to_s, isRecording }, width, height, mark, colour) {
    context.fillStyle = colour.muted;
    context.font = "11px system-ui, sans-serif";
    const span_s = to_s - from_s;
    const step = STEPS_S.find((step) => (step / span_s) * width >= 64) ?? 43200;
    for (let count = isRecording ? 0 : 1; count * step < span_s; count++) {
      const at = (width * count * step) / span_s;
      const x = isRecording ? at : width - at;
      context.fillRect(x, TOP + BAND, 1, 4);
      const label = isRecording ? clock(count * step) : `−${clock(count * step)}`;
      const long = context.measureText(label).width;
      const left = Math.min(width - long, Math.max(0, x - 13));
      if (left + long + 6 < mark || left > mark + 52) context.fillText(label, left, height - 3);
    }
  }

  return (view, colour) => {
    const { rows, events, from_s, to_s, shown_s, isRecording } = view;
    shown = view;
    const { context, width, height } = prepare(canvas);
    const look = `${width} ${height} ${colour.back} ${isRecording}`;
    const key = `${look} ${rows.length} ${rows.at(-1)?.number} ${events.length} ${to_s}`;
    const isOld = performance.now() - drawn.at_ms > PAUSE_MS;
    if (key !== drawn.key && (isRecording || isOld || look !== drawn.look)) {
      drawBand(view, colour);
      drawn = { key, look, at_ms: performance.now() };
      range = { from_s, to_s, isRecording };
    }
    context.clearRect(0, 0, width, height);
    if (band.width) context.drawImage(band, 0, 0, width, height);
    const share = shown_s == null ? 1 : (shown_s - range.from_s) / (range.to_s - range.from_s);
    const at = Math.min(width - 1.5, Math.max(1, width * share));
    const back_s = shown_s == null ? 0 : to_s - shown_s;
    const label = isRecording ? clock(shown_s ?? 0, 1) : shown_s == null ? "now" : `−${back_s.toFixed(1)} s`;
    const place = Math.min(width - 48, Math.max(0, at - 18));
    drawLabels(context, range, width, height, place, colour);
    context.font = "600 12px system-ui, sans-serif";
    context.fillStyle = colour.ink;
    context.fillRect(at - 1, 0, 2.5, TOP + BAND + 5);
    context.fillText(label, place, height - 3);
    canvas.setAttribute("aria-valuemin", isRecording ? "0" : String(-SPAN_S));
    canvas.setAttribute("aria-valuemax", isRecording ? to_s.toFixed(1) : "0");
    canvas.setAttribute("aria-valuenow", (isRecording ? shown_s ?? 0 : -back_s).toFixed(1));
  };
}
