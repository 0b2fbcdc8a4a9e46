// The last five minutes: where the wheels were blocked, how fast the robot was, what happened, and which time is shown.

import { prepare } from "./charts.js";

export const SPAN_S = 300;
const TOP = 4;
const BAND = 26;

/** The axis; calls `choose` with a time [s], or null for now. */
export function timeline(canvas, choose) {
  let state = null;

  const timeAt = (event) => {
    const share = Math.min(1, Math.max(0, event.offsetX / canvas.clientWidth));
    return state.now_s - SPAN_S * (1 - share);
  };
  canvas.addEventListener("pointerdown", (event) => {
    if (!state) return;
    canvas.setPointerCapture(event.pointerId);
    choose(timeAt(event));
  });
  canvas.addEventListener("pointermove", (event) => {
    if (state && event.buttons) choose(timeAt(event));
  });
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1, PageUp: -10, PageDown: 10 }[event.key];
    if (!state || !step) return;
    event.preventDefault();
    const next = (state.shown_s ?? state.now_s) + step * (event.shiftKey ? 0.1 : 1);
    choose(next >= state.now_s ? null : next);
  });

  return (rows, events, now_s, shown_s, colour) => {
    state = { now_s, shown_s };
    const { context, width, height } = prepare(canvas);
    const x = (time_s) => width * (1 - (now_s - time_s) / SPAN_S);
    context.clearRect(0, 0, width, height);
    context.fillStyle = colour.back;
    context.fillRect(0, TOP, width, BAND);
    rows.forEach((row, index) => {
      const next = rows[index + 1]?.time_s ?? row.time_s + 0.1;
      const length = x(Math.min(next, row.time_s + 0.5)) - x(row.time_s);
      const share = row.blocked ? 1 : Math.min(1, row.speed_mps ?? 0);
      context.fillStyle = [colour.robot, colour.stop, colour.idle][row.blocked];
      context.globalAlpha = [0.75, 0.35, 0.18][row.blocked];
      context.fillRect(x(row.time_s), TOP + BAND * (1 - share), length + 0.3, BAND * share);
    });
    context.globalAlpha = 1;
    const styles = { bad: colour.stop, warning: colour.warning, good: colour.good };
    for (const event of events) {
      if (!styles[event.kind] || event.time_s < now_s - SPAN_S) continue;
      context.fillStyle = styles[event.kind];
      context.beginPath();
      context.moveTo(x(event.time_s) - 4, 0);
      context.lineTo(x(event.time_s) + 4, 0);
      context.lineTo(x(event.time_s), 8);
      context.fill();
    }
    context.fillStyle = colour.muted;
    context.font = "11px system-ui, sans-serif";
    const step = width < 500 ? 120 : 30;
    for (let back = step; back < SPAN_S; back += step) {
      const label = `−${Math.floor(back / 60)}:${String(back % 60).padStart(2, "0")}`;
      context.fillRect(x(now_s - back), TOP + BAND, 1, 4);
      context.fillText(label, x(now_s - back) - 13, height - 3);
    }
    const at = Math.min(width - 1.5, x(shown_s ?? now_s));
    context.fillStyle = colour.ink;
    context.fillRect(at - 1, 0, 2.5, TOP + BAND + 5);
    const back = shown_s == null ? 0 : now_s - shown_s;
    const label = shown_s == null ? "now" : `−${back.toFixed(1)} s`;
    context.font = "600 12px system-ui, sans-serif";
    context.fillText(label, Math.min(width - 48, Math.max(0, at - 18)), height - 3);
    canvas.setAttribute("aria-valuenow", (-back).toFixed(1));
  };
}
