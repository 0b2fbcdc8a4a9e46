// The processes as a graph of the loop: state, age, rate, processor, restarts, who is in charge, candidates and standby.

const NS = "http://www.w3.org/2000/svg";
const BOX = { width: 116, height: 58 };
const PLACES = {
  robot: [2, 92], estimator: [2, 2], obstacles: [162, 2], controller: [318, 2], actuator: [318, 92],
};
const ARROWS = [
  ["M62 92 V65", "odometry", 57, 80, "end"], ["M118 31 H157", "pose", 139, 26, "middle"], ["M278 31 H313", "", 0, 0],
  ["M376 60 V87", "command", 382, 77, "start"], ["M318 121 H123", "actuation", 222, 116, "middle"],
  ["M92 92 C96 68 186 88 200 65", "scan", 146, 72, "middle"],
];

function element(name, attributes, parent, text) {
  const made = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text != null) made.textContent = text;
  parent.append(made);
  return made;
}

/** The graph in an SVG element, with a note above; returns a function that shows a system. */
export function loop(svg, note) {
  const defs = element("defs", {}, svg);
  const head = element("marker", { id: "head", viewBox: "0 0 8 8", refX: 6, refY: 4, markerWidth: 6, markerHeight: 6, orient: "auto" }, defs);
  element("path", { d: "M0 0 L8 4 L0 8 Z", class: "head" }, head);
  for (const [path, topic, x, y, anchor] of ARROWS) {
    element("path", { d: path, class: "arrow", "marker-end": "url(#head)" }, svg);
    element("text", { x, y, class: "topic", "text-anchor": anchor ?? "start" }, svg, topic);
  }
  const boxes = {};
  for (const [role, [x, y]] of Object.entries(PLACES)) {
    const group = element("g", { transform: `translate(${x} ${y})` }, svg);
    element("rect", { class: "other", x: 5, y: 5, width: BOX.width, height: BOX.height, rx: 7 }, group);
    element("rect", { class: "box", width: BOX.width, height: BOX.height, rx: 7 }, group);
    element("circle", { class: "lamp", cx: 11, cy: 13, r: 4.5 }, group);
    element("text", { x: 21, y: 17, class: "role" }, group, role);
    const lines = [30, 42, 53].map((y) => element("text", { x: 9, y, class: "muted" }, group));
    const corner = element("text", { x: BOX.width - 7, y: 17, "text-anchor": "end", class: "muted" }, group);
    const title = element("title", {}, group);
    boxes[role] = { group, lines, corner, title };
  }
  return (system) => {
    Object.entries(boxes).forEach(([role, box]) => show(box, role, system));
    const others = system?.status?.processes?.filter((row) => !(row.role in PLACES)) ?? [];
    const refused = system?.status?.refused?.length ?? 0;
    const parts = others.map((row) => `${row.role} ${row.implementation}: ${row.state}`);
    parts.push(...(system?.status?.companions ?? []).map((row) => `${row.name}: ${row.state}`));
    note.title = parts.join("\n");
    if (refused) parts.push(`samples refused by ${refused} rule${refused > 1 ? "s" : ""}`);
    note.textContent = parts.join(" · ");
  };
}

function show({ group, lines, corner, title }, role, system) {
  const rows = system?.status?.processes?.filter((row) => row.role === role) ?? [];
  const others = rows.filter((row) => ["shadow", "standby"].includes(row.state));
  const row = rows.find((row) => !others.includes(row)) ?? rows[0];
  group.setAttribute("data-state", row?.state ?? "none");
  group.classList.toggle("pair", others.length > 0);
  if (!row) {
    lines.forEach((line) => { line.textContent = ""; });
    corner.textContent = "";
    title.textContent = role;
    return;
  }
  const incarnation = system.authority?.[["robot", "estimator", "obstacles", "controller", "actuator"].indexOf(role)];
  corner.textContent = `#${incarnation ?? "–"}`;
  const name = row.implementation.split("/").pop();
  const restarts = row.restarts ? ` ↻${row.restarts}` : "";
  lines[0].textContent = row.state === "ready" ? short(name, 17 - restarts.length) + restarts : `${row.state}`;
  const age = row.last_sample_age_ms != null && row.last_sample_age_ms < 9999 ? `${row.last_sample_age_ms.toFixed(0)} ms` : "";
  lines[1].textContent = `${row.rate_hz.toFixed(1)} Hz · ${age}`;
  const other = others[0];
  lines[2].textContent = other ? `${other.state}: ${short(other.implementation.split("/").pop(), 10)}` : [row.cpu_percent == null ? "" : `${share(row, system).toFixed(1)} % · `, `pid ${row.pid}`].join("");
  title.textContent = [
    `${role}: ${row.implementation}, process ${row.pid}, ${row.state}`,
    `newest output ${row.last_sample_age_ms?.toFixed(0) ?? "–"} ms old, ${row.memory_kib == null ? "" : `${row.memory_kib} KiB, `}${row.restarts} restarts`,
    ...others.map((other) => `${other.state}: ${other.implementation}, process ${other.pid}`),
    ...row.last_words,
  ].join("\n");
}

// The kernel counts processor time in hundredths of a second, too coarse for half a second: the mean of some seconds.
const shares = new Map();

function share({ pid, cpu_percent: percent }, system) {
  const known = shares.get(pid) ?? { mean: percent, status: system.status };
  if (known.status !== system.status) Object.assign(known, { mean: known.mean + 0.1 * (percent - known.mean), status: system.status });
  if (shares.size > 100) shares.clear();
  shares.set(pid, known);
  return known.mean;
}

function short(text, length) {
  return text.length > length ? `${text.slice(0, length - 1)}…` : text;
}
