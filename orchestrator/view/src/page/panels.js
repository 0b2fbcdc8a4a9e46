// State, figures, scanner and events as text.

import { clock } from "./player.js";

const BLOCKED = {
  no_command: "no valid command", invalid_command: "invalid command", stale_command: "stale command",
  stop_requested: "stop requested", start: "waiting for the first commands",
};
const MARKS = {
  waiting: "…", starting: "…", driving: "▶", blocked: "■", paused: "❚❚", landed: "✓", stopping: "■", over: "○", lost: "✕",
  orphaned: "!", silent: "!", collision: "✕", connecting: "…",
};

const words = (name) => name.replaceAll("_", " ");

/** The state of everything in one word, and a sentence of details. */
export function stateOf(system, frame, lost) {
  if (lost) return ["lost", "Connection lost", `${lost}; trying again`];
  if (!system) return ["connecting", "Connecting", ""];
  if (system.connection === "waiting") return ["waiting", "Waiting", `for system ${system.system_id}`];
  if (system.connection === "over") return ["over", "Run ended", "the last frame stays; the next run is shown when it starts"];
  const { status, status_age_s: age } = system;
  if (status?.state === "driverless") return ["orphaned", "Orphaned", "the orchestrator is gone: scanloop adopt takes over"];
  if (age != null && age > 3) return ["silent", "No answer", `of the orchestrator for ${age.toFixed(0)} s`];
  if (frame?.truth?.collided) return ["collision", "Collision", ""];
  const actuation = frame?.actuation;
  // A run that has landed ends: what matters is that it has.
  const hasLanded = actuation?.reason === "landed" || frame?.command?.reason === "landed";
  if (hasLanded && actuation?.kind === "block") return ["landed", "Landed", "the goal is reached by the robot's own estimate"];
  if (status?.state === "stopping") return ["stopping", "Ending", detail(frame)];
  if (!actuation || status?.state === "starting" || status?.state === "connecting") return ["starting", "Starting", ""];
  const byHand = actuation.driven_by === "person";
  if (actuation.kind === "drive") {
    const text = byHand ? "Driven by hand" : frame.command?.kind === "land" ? "Landing" : "Driving";
    return ["driving", text, detail(frame)];
  }
  if (actuation.reason === "paused") return ["paused", "Paused", "the wheels are blocked until resume"];
  if (byHand && ["released", "commanded"].includes(actuation.reason)) return ["paused", "Held by hand", detail(frame)];
  return ["blocked", "Wheels blocked", detail(frame)];
}

function detail(frame) {
  const { command, actuation, scanner } = frame ?? {};
  const parts = [];
  if (actuation?.kind === "block") {
    if (actuation.reason !== "commanded") parts.push(BLOCKED[actuation.reason] ?? words(actuation.reason));
    else if (command?.blocking) parts.push(`by ${command.blocking}`);
    else if (actuation.stop_reason !== "scanner") parts.push(words(actuation.stop_reason));
  }
  if (scanner && scanner.state !== "healthy") parts.push(`scanner ${scanner.state}`);
  if (actuation?.kind === "drive" && command?.side) parts.push(`passing on the ${command.side > 0 ? "left" : "right"}`);
  return parts.join(" · ");
}

/** The texts of the page; returns functions that show parts of it. */
export function panels(by) {
  const set = (id, text) => {
    const place = by(id);
    if (place.textContent !== text) place.textContent = text;
  };
  // A line that ends with an ellipsis where it is too long.
  const setLine = (id, text) => {
    set(id, text);
    if (by(id).title !== text) by(id).title = text;
  };
  const digits = (value, count) => (value == null ? "–" : value.toFixed(count));
  let shown = "";

  return {
    state([state, text, detail], system, frame) {
      document.body.dataset.state = state;
      set("state-mark", MARKS[state] ?? "");
      set("state-text", text);
      setLine("state-detail", detail);
      document.title = `${text} · Scanloop`;
      by("hint").hidden = state !== "waiting";
      if (state === "waiting" && by("hint").dataset.of !== system.system_id) {
        const code = document.createElement("code");
        code.textContent = `scanloop ${system.system_id === "default" ? "" : `--system-id ${system.system_id} `}run`;
        by("hint").replaceChildren("No run yet. Start one:", code);
        by("hint").dataset.of = system.system_id;
      }
      const status = system?.status;
      const place = system?.file ? `recording ${system.file}` : `system ${system?.system_id ?? "–"}`;
      const facts = [status?.scenario, place];
      if (system?.lost) facts.push(`${system.lost} samples lost`);
      if (system?.complete === false) facts.push("cut off");
      const scan = frame?.row?.scan_id ?? status?.scan;
      if (scan != null) facts.push(`scan ${scan}`);
      // A report has fewer maps than scans.
      if (frame?.map_scan != null) facts.push(`map of ${frame.map_scan}`);
      if (frame?.time_s != null) facts.push(`${frame.time_s.toFixed(1)} s`);
      setLine("run", facts.filter(Boolean).join(" · "));
    },
    frame(frame) {
      const row = frame?.row;
      set("tile-speed", digits(row?.speed_mps, 2));
      set("tile-reaction", digits(row?.reaction_us == null ? null : row.reaction_us / 1000, 1));
      set("tile-clearance", digits(row?.clearance_m, 2));
      set("tile-goal", digits(frame?.goal_m, frame?.goal_m < 100 ? 1 : 0));
      const margin = frame?.command?.margin_m;
      const centimetres = (value) => (100 * value).toFixed(1);
      const parts = Object.entries(margin ?? {}).sort(([, one], [, other]) => other - one);
      const sum = parts.reduce((sum, [, part]) => sum + part, 0);
      by("margin-note").title = parts.map(([name, part]) => `${name} ${centimetres(part)} cm`).join(", ");
      set("margin-note", sum > 0 ? `margin ${centimetres(sum)} cm, ${centimetres(parts[0][1])} of it for ${parts[0][0]}` : "");
      const scanner = frame?.scanner;
      by("scanner-panel").dataset.state = scanner?.state ?? "none";
      const percent = (share) => `${Math.round(100 * share)} %`;
      setLine("scanner-note", scanner ? `${scanner.state} · ${percent(scanner.returned_share)} returns · ` +
        `${scanner.unseen_sectors.length}/62 sectors unseen · sees ${scanner.seen_ahead_m.toFixed(1)} m` : "no description yet");
    },
    /** The last events up to a time; without `epoch_ms` times count from the start. */
    events(events, until_s, epoch_ms) {
      const end = events.findLastIndex((event) => event.time_s <= until_s) + 1;
      const newest = `${events[end - 1]?.number ?? 0} ${epoch_ms}`;
      if (newest === shown) return;
      shown = newest;
      by("events").replaceChildren(...events.slice(Math.max(0, end - 6), end).map((event) => {
        const item = document.createElement("li");
        Object.assign(item.dataset, { kind: event.kind, number: event.number });
        Object.assign(item, { tabIndex: 0, title: "Why?" });
        const time = document.createElement("time");
        time.textContent = epoch_ms == null ? clock(event.time_s, 1) : new Date(epoch_ms + 1000 * event.time_s).toTimeString().slice(0, 8);
        const text = document.createElement("b");
        text.textContent = event.text;
        item.append(time, text);
        return item;
      }));
      // The newest is the last, also where long texts need more than the place there is.
      by("events").scrollTop = by("events").scrollHeight;
    },
  };
}

/** What the colours of the map mean. */
export function legend(place, colour) {
  const entries = [
    ["robot", "robot, with its centre", (c) => rect(c)], ["truth", "true body and path", (c) => line(c)],
    ["estimate", "estimated path", (c) => line(c, "4 3")],
    ["estimate", "where the centre is with 95 %", (c) => oval(c, 0.1)],
    ["plan", "plan, with body and margin", (c) => rect(c, 0.25)],
    ["body", "obstacle: the body keeps out", (c) => rect(c)],
    ["cover", "its ellipse: the centre keeps out", (c) => oval(c)],
    ["cover", "remembered, not seen now", (c) => line(c, "3 3")],
    ["ink", "number and speed of an obstacle", (c) => label(c, "4")],
    ["muted", "#4: fourth process of its role", (c) => label(c, "#4")],
    ["scan", "returns of the scanner", (c) => dots(c)], ["stop", "sector without evidence", (c) => rect(c, 0.15)],
    ["goal", "goal", (c) => rect(c, 0.3)],
  ];
  const svg = (inner) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    made.setAttribute("viewBox", "0 0 26 14");
    for (const [name, attributes, text = ""] of inner) {
      const part = document.createElementNS("http://www.w3.org/2000/svg", name);
      Object.entries(attributes).forEach(([key, value]) => part.setAttribute(key, value));
      part.textContent = text;
      made.append(part);
    }
    return made;
  };
  const rect = (fill, opacity = 1) => [["rect", { width: 26, height: 12, y: 1, rx: 3, fill, "fill-opacity": opacity, stroke: fill }]];
  const line = (stroke, dash = "") => [["path", { d: "M0 7 H26", stroke, "stroke-width": 2, "stroke-dasharray": dash }]];
  const oval = (stroke, opacity = 0) => [["ellipse", { cx: 13, cy: 7, rx: 12, ry: 6, stroke, fill: stroke, "fill-opacity": opacity }]];
  const label = (fill, text) => [["text", { x: 0, y: 11, fill, "font-size": 10 }, text]];
  const dots = (fill) => [3, 9, 15, 21].map((cx) => ["circle", { cx, cy: 7, r: 1.6, fill }]);
  place.replaceChildren(...entries.map(([key, text, draw]) => {
    const row = document.createElement("div");
    row.append(svg(draw(colour[key])), text);
    return row;
  }));
}
