// Two drives, or two sets of them, along their way: charts, where they part, and the table of `compare`.
import { onResize, prepare } from "./charts.js";
import { latency } from "./latency.js";
import { unpack } from "./link.js";

const LEFT = 92, GAP = 26, TALL = 120;
const STRIPS = [["across the course", "m", 1], ["speed", "m/s", 2], ["steering", "rad", 3], ["clearance", "m", 4], ["scan to actuation", "ms", 5]];

const element = (id) => document.getElementById(id);
const canvas = element("ways");
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const axis = { us: 0 };
const stages = ["a", "b"].map((side) => latency(element(`stages-${side}`), element(`note-${side}`), axis));
let drives = null;
let at_m = null;

const number = (value, digits = 3) => (value == null ? "" : value.toFixed(digits));

/** Of a drive, the number of the last station up to a place; -1 before its first. */
const stationAt = ({ stations }, along_m) => stations.findLastIndex(([place]) => place <= along_m + 1e-6);

function show({ names, sentences, compared }) {
  ["a", "b"].forEach((id, side) => { element(id).textContent = `${id.toUpperCase()}: ${names[side]}`; });
  element("parts").replaceChildren(...sentences.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
  const body = element("figures").tBodies[0];
  for (const { name, drives: of, a, b, difference, interval } of compared.figures) {
    const row = body.insertRow();
    const some = of.join() === compared.drives.join() ? "" : `, of ${of.join(" and ")}`;
    const sign = difference > 0 ? "+" : "";
    const cells = [name + some, number(a), number(b), sign + number(difference), interval ? interval.map((end) => number(end)).join(" to ") : ""];
    for (const text of cells) row.insertCell().textContent = text;
    // An interval without zero is a difference.
    row.classList.toggle("differs", interval != null && interval[0] * interval[1] > 0);
  }
  element("stages").hidden = !drives.ways.some(([first]) => first?.scans);
  // Of several drives the first is shown.
  stages.forEach((panel, side) => {
    const { seed } = drives.ways[side][0];
    const which = drives.ways[side].length > 1 ? ` (seed ${seed ?? "?"})` : "";
    document.querySelectorAll("#stages h2 b")[side].textContent = `${"AB"[side]}${which}, scan to actuation`;
    panel.system(drives.ways[side][0]);
  });
}

/** Least and largest value of a column over all drives, a little apart. */
function range(index) {
  const values = drives.ways.flat().flatMap(({ stations }) => stations.map((row) => row[index])).filter((value) => value != null);
  const [low, high] = values.reduce(([low, high], value) => [Math.min(low, value), Math.max(high, value)], [Infinity, -Infinity]);
  if (!(high >= low)) return null;
  const pad = Math.max(0.08 * (high - low), 0.01);
  return [low < 0 ? low - pad : Math.max(0, low - pad), high + pad];
}

function draw() {
  if (!drives) return;
  const strips = STRIPS.map(([name, unit, index]) => ({ name, unit, index, range: range(index) })).filter((strip) => strip.range);
  canvas.style.height = `${strips.length * (TALL + GAP) + 18}px`;
  const { context, width } = prepare(canvas);
  context.clearRect(0, 0, width, canvas.height);
  const [from, to] = drives.extent;
  const x = (along_m) => LEFT + ((width - LEFT - 8) * (along_m - from)) / (to - from || 1);
  strips.forEach((strip, place) => chart(context, strip, { top: place * (TALL + GAP) + GAP - 8, width, x, is_last: place === strips.length - 1 }));
}

function chart(context, { name, unit, index, range: [low, high] }, { top, width, x, is_last }) {
  const y = (value) => top + TALL * (1 - (value - low) / (high - low));
  context.fillStyle = colour("surface");
  context.fillRect(LEFT, top, width - LEFT - 8, TALL);
  const line = (x1, y1, x2, y2) => { context.beginPath(); context.moveTo(x1, y1); context.lineTo(x2, y2); context.stroke(); };
  context.lineWidth = 1;
  context.strokeStyle = colour("line");
  if (low < 0 && high > 0) line(LEFT, y(0), width - 8, y(0));
  context.strokeStyle = colour("stop");
  context.setLineDash([4, 4]);
  for (const { along_m } of drives.compared.parts) line(x(along_m), top, x(along_m), top + TALL);
  context.setLineDash([]);
  const many = drives.ways.flat().length > 2;
  drives.ways.forEach((side, which) => {
    context.strokeStyle = colour(which ? "body" : "plan");
    context.lineWidth = many ? 1 : 2;
    // Where both are the same, one is seen below the other.
    context.setLineDash(which ? [7, 4] : []);
    for (const { stations } of side) {
      context.beginPath();
      let is_new = true;
      for (const row of stations) {
        if (row[index] == null) { is_new = true; continue; }
        if (is_new) context.moveTo(x(row[0]), y(row[index])); else context.lineTo(x(row[0]), y(row[index]));
        is_new = false;
      }
      context.stroke();
    }
  });
  context.setLineDash([]);
  if (at_m != null) { context.strokeStyle = colour("ink"); line(x(at_m), top, x(at_m), top + TALL); }
  context.fillStyle = colour("ink");
  context.font = "600 12px system-ui, sans-serif";
  context.textAlign = "left";
  context.fillText(`${name} [${unit}]`, LEFT, top - 5);
  context.fillStyle = colour("muted");
  context.font = "11px system-ui, sans-serif";
  context.textAlign = "right";
  for (const value of [low, high]) context.fillText(number(value, 2), LEFT - 6, y(value) + (value === high ? 10 : -2));
  if (!is_last) return;
  const [from, to] = drives.extent;
  for (const share of [0, 0.5, 1]) {
    context.textAlign = ["left", "center", "right"][2 * share];
    context.fillText(`${number(from + share * (to - from), 1)} m`, LEFT + share * (width - LEFT - 8), top + TALL + 14);
  }
}

/** The values of the first drive of each side at a place. */
function point(along_m) {
  const [from, to] = drives.extent;
  at_m = Math.min(to, Math.max(from, along_m));
  const places = drives.ways.map(([first]) => (first ? stationAt(first, at_m) : -1));
  const rows = drives.ways.map(([first], side) => first?.stations[places[side]]);
  stages.forEach((panel, side) => panel.frame({ latency_us: drives.ways[side][0]?.scans?.[places[side]] }));
  const parts = STRIPS.map(([name, unit, index]) => `${name} ${rows.map((row) => number(row?.[index]) || "–").join(" / ")} ${unit}`);
  element("place").textContent = `${at_m.toFixed(1)} m, A / B: ${parts.join(", ")}`;
  draw();
}

const at = (event) => {
  const { left, width } = canvas.getBoundingClientRect();
  const [from, to] = drives.extent;
  return from + ((event.clientX - left - LEFT) / (width - LEFT - 8)) * (to - from);
};

unpack().then((content) => {
  const places = content.ways.flat().flatMap(({ stations }) => [stations[0][0], stations.at(-1)[0]]);
  drives = { ...content, extent: [Math.min(...places), Math.max(...places)] };
  show(drives);
  onResize(draw);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  canvas.addEventListener("pointermove", (event) => point(at(event)));
  canvas.addEventListener("pointerdown", (event) => point(at(event)));
  canvas.addEventListener("keydown", ({ key }) => {
    const step = { ArrowLeft: -0.1, ArrowRight: 0.1 }[key];
    if (step) point((at_m ?? drives.extent[0]) + step);
  });
  point(content.compared.parts[0]?.along_m ?? drives.extent[0]);
}).catch((error) => { element("place").textContent = `the drives in this file can't be read: ${error.message}`; });
