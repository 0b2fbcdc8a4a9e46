// Where the time of the newest scan went, stage by stage, with percentiles of the last minute and a history.

import { niceAbove, prepare } from "./charts.js";

const NS = "http://www.w3.org/2000/svg";
const ROLES = ["estimator", "obstacles", "controller", "actuator"];

/** The panel; returns functions that show a frame, the percentiles of a system, and the rows so far. Panels may share an axis. */
export function latency(place, note, axis = { us: 0 }) {
  const table = document.createElement("table");
  const head = table.insertRow();
  for (const name of ["stage", "", "last", "p50", "p99"]) {
    const cell = document.createElement("th");
    cell.textContent = name;
    head.append(cell);
  }
  const rows = [...ROLES, "all"].map((role) => {
    const row = table.insertRow();
    const [name, bar, ...figures] = Array.from({ length: 5 }, () => row.insertCell());
    name.textContent = role === "all" ? "whole" : role;
    const svg = document.createElementNS(NS, "svg");
    svg.setAttribute("preserveAspectRatio", "none");
    svg.setAttribute("viewBox", "0 0 1000 12");
    const parts = ["hop", "compute", "hop"].map((kind) => {
      const part = document.createElementNS(NS, "rect");
      part.setAttribute("class", kind);
      part.setAttribute("height", "12");
      svg.append(part);
      return part;
    });
    bar.append(svg);
    return { role, parts, figures };
  });
  const canvas = document.createElement("canvas");
  place.append(table, canvas);
  let isFitted = false;
  const recent = [];

  const milliseconds = (value) => (value == null ? "–" : (value / 1000).toFixed(value < 9995 ? 2 : 1));

  return {
    frame(frame) {
      const times = frame?.latency_us;
      note.textContent = times ? `ms, data age ${(times.data_age / 1000).toFixed(0)} ms` : "ms";
      const total = times?.scan_to_actuation ?? 0;
      // The axis follows the usual scan, not the slowest, and changes rarely, so that bars can be compared.
      if (total) recent.push(total);
      if (recent.length === 20) {
        const usual = niceAbove(1.3 * recent.toSorted((one, other) => one - other)[15]);
        if (usual > axis.us || usual < axis.us / 2) axis.us = usual;
        recent.length = 0;
      }
      const axis_us = axis.us || 1000;
      let start = 0;
      for (const { role, parts, figures } of rows) {
        const stage = times?.stages.find((stage) => stage.role === role);
        const widths = stage ? [stage.hop, stage.compute, stage.publish] : [0, 0, 0];
        widths.forEach((width, index) => {
          parts[index].setAttribute("x", (1000 * start) / axis_us);
          parts[index].setAttribute("width", (1000 * width) / axis_us);
          start += width;
        });
        const sum = role === "all" ? times?.scan_to_actuation : stage && stage.hop + stage.compute + stage.publish;
        figures[0].textContent = milliseconds(sum);
        if (role === "all") {
          parts[1].setAttribute("x", 0);
          parts[1].setAttribute("width", (1000 * total) / axis_us);
        }
      }
    },
    system(system) {
      const report = system?.latency_us;
      // The bars of the first scan have the usual length too.
      if (!isFitted && report?.scan_to_actuation?.p50 > 0) axis.us = Math.max(axis.us, niceAbove(1.3 * report.scan_to_actuation.p50));
      isFitted ||= report?.scan_to_actuation?.p50 > 0;
      for (const { role, figures } of rows) {
        const found = role === "all" ? report?.scan_to_actuation : report?.stages?.[role] ?? report?.stages?.compute?.[role];
        figures[1].textContent = milliseconds(found?.p50);
        figures[2].textContent = milliseconds(found?.p99);
      }
    },
    history(rows, until_s, colour) {
      const { context, width, height } = prepare(canvas);
      const seen = rows.filter((row) => row.reaction_us != null && row.time_s > until_s - 60 && row.time_s <= until_s);
      const sorted = seen.map((row) => row.reaction_us).sort((one, other) => one - other);
      // Rare slow scans are cut, so that the usual ones can be seen.
      const top = niceAbove(Math.max(1000, 2 * (sorted[Math.floor(0.9 * sorted.length)] ?? 0)));
      context.clearRect(0, 0, width, height);
      context.strokeStyle = colour.line;
      context.beginPath();
      context.moveTo(0, height - 0.5);
      context.lineTo(width, height - 0.5);
      context.stroke();
      context.fillStyle = colour.plan;
      for (const row of seen) {
        const x = width * (1 - (until_s - row.time_s) / 60);
        const bar = Math.min(1, row.reaction_us / top) * (height - 12);
        context.fillStyle = row.reaction_us > top ? colour.warning : colour.plan;
        context.fillRect(x - 1, height - bar, 1.6, bar);
      }
      context.fillStyle = colour.muted;
      context.font = "11px system-ui, sans-serif";
      const largest = sorted.length ? `, largest ${milliseconds(sorted.at(-1))} ms` : "";
      context.fillText(`last minute, bars up to ${top / 1000} ms${largest}`, 0, 10);
    },
  };
}
