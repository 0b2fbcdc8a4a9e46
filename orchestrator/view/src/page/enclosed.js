// The source of a page that is a file: it answers from the drive enclosed in it as a server would. It stands for link.js.

const MAX_ROWS = 3600;

const fragment = new URLSearchParams(location.hash.slice(1));

export const hasToken = false;
export const startTime = Number.isFinite(parseFloat(fragment.get("t"))) ? parseFloat(fragment.get("t")) : null;

/** There is nobody to ask for anything but the past. */
export const urgent = async () => ({ ok: false });

const drive = unpack().then(({ columns, ...rest }) => ({ rows: rowsOf(columns ?? []), ...rest }));

/** What is enclosed in the page. */
export async function unpack() {
  const text = document.getElementById("drive").textContent;
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).json();
}

// A column has the steps from value to value, in units of its resolution, and null where nothing is known.
function rowsOf(columns) {
  const rows = Array.from(columns[0]?.steps ?? [], () => ({}));
  for (const { name, per_unit, steps } of columns) {
    let value = 0;
    steps.forEach((step, index) => {
      value += step ?? 0;
      rows[index][name] = step == null ? null : value / per_unit;
    });
  }
  return rows;
}

/** The rows around a time, or its frame: the newest one that is enclosed, with the figures and the place of the robot of that time. */
export async function ask(path) {
  const { rows, frames } = await drive;
  const at_s = new URLSearchParams(path.split("?")[1]).get("at_ms") / 1000;
  if (path.startsWith("/history")) {
    const around = rows.filter((row) => row.time_s > at_s - 90 && row.time_s <= at_s + 30);
    return { ok: true, json: async () => ({ rows: around }) };
  }
  if (path.startsWith("/why")) return reasonsOf(rows, frames, Number(new URLSearchParams(path.split("?")[1]).get("scan")));
  const index = Math.max(0, rows.findLastIndex((row) => row.time_s <= at_s));
  const [kept, frame] = frames.findLast(([kept]) => kept <= index) ?? frames[0];
  return { ok: true, json: async () => moved(unfolded(frame), rows[kept], rows[index]) };
}

// Those of the frame that is shown for a scan.
function reasonsOf(rows, frames, scan) {
  const index = rows.findLastIndex((row) => row.scan_id === scan);
  const [kept, { why }] = frames.findLast(([kept]) => kept <= index) ?? frames[0];
  if (!why) return { ok: false, text: async () => "This page has no answer: ask the recording, scanloop why FILE SCAN." };
  const sentences = why.sentences.map(([about, text]) => ({ about, text }));
  if (why.is_short) sentences.push({ about: "more", text: `scanloop why FILE ${rows[kept].scan_id}` });
  return { ok: true, json: async () => ({ scan: rows[kept].scan_id, sentences }) };
}

function moved(frame, before, row) {
  const turn = row.yaw_rad - before.yaw_rad;
  const { pose, truth } = frame;
  return {
    ...frame, row,
    time_s: frame.time_s == null ? null : frame.time_s + row.time_s - before.time_s,
    body: pose && { ...pose, x_m: row.x_m, y_m: row.y_m, yaw_rad: pose.yaw_rad + turn },
    truth: truth && { ...truth, x_m: row.true_x_m, y_m: row.true_y_m, yaw_rad: truth.yaw_rad + turn },
    map_scan: row.scan_id === before.scan_id ? null : before.scan_id,
  };
}

// The ranges of a scan are enclosed as steps from beam to beam [cm].
function unfolded(frame) {
  if (!frame.scan?.steps_cm) return frame;
  let range_cm = 0;
  const ranges = Uint16Array.from(frame.scan.steps_cm, (step) => 10 * (range_cm += step));
  return { ...frame, scan: { ...frame.scan, ranges_mm_base64: btoa(String.fromCharCode(...new Uint8Array(ranges.buffer))) } };
}

// As of a server: the whole in larger steps, each blocked if any of its rows is.
function overview(rows) {
  const step = Math.ceil(rows.length / MAX_ROWS);
  const starts = Array.from(rows.keys()).filter((index) => index % step === 0);
  return starts.map((index) => rows.slice(index, index + step).find((row) => row.blocked === 1) ?? rows[index]);
}

/** Calls `on.open` with the overview and all events, and `on.system` with what stays the same. */
export async function connect(on) {
  try {
    const { rows, events, system } = await drive;
    on.open({ rows: overview(rows), events, recording: { frames: rows.length } });
    on.system(system);
  } catch (error) {
    on.lost(`the drive in this file can't be read: ${error.message}`);
  }
}
