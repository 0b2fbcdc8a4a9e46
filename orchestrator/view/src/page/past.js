// Earlier frames: those of a running system by number, those of a recording by time.

import { ask } from "./link.js";
import { SPAN_S } from "./timeline.js";

/** What the time axis shows [s]. */
export function bounds({ overview, rows, system, lost }) {
  if (overview) return { from_s: 0, to_s: Math.max(0.1, system?.time_s ?? 0) };
  const to_s = Math.max(rows.at(-1)?.time_s ?? 0, lost ? 0 : system?.time_s ?? 0);
  return { from_s: to_s - SPAN_S, to_s };
}

/** A function that fetches the frame of the shown time, and hands it to `came`. */
export function past(page, came) {
  let isAsking = false;

  // One request at a time; the time that is wanted then decides about the next.
  async function fetchPast() {
    if (page.shown_s == null || isAsking) return;
    isAsking = true;
    let isNew = false;
    try {
      if (page.overview) await fetchRows(page.shown_s);
      isNew = await fetchFrame();
    } catch { /* The stream reports a lost connection. */ }
    isAsking = false;
    if (isNew) fetchPast();
  }

  async function fetchFrame() {
    const row = page.rows.findLast((row) => row.time_s <= page.shown_s) ?? page.rows[0];
    if (!row || page.past?.row.number === row.number) return false;
    const response = await ask(page.overview ? `/frame?at_ms=${Math.ceil(1000 * row.time_s)}` : `/frame?number=${row.number}`);
    const frame = response.ok ? await response.json() : null;
    if (!frame || page.shown_s == null) return false;
    came(frame);
    return true;
  }

  // Rows around a time, if those that are there don't reach as far as the charts.
  async function fetchRows(time_s) {
    const [first, last] = page.window ?? [Infinity, -Infinity];
    const { to_s } = bounds(page);
    if (first <= Math.max(0, time_s - 60) && last >= Math.min(to_s, time_s + 5)) return;
    const response = await ask(`/history?at_ms=${Math.round(1000 * time_s)}`);
    if (!response.ok) return;
    page.rows = (await response.json()).rows;
    page.window = [time_s - 90, time_s + 30];
  }

  return fetchPast;
}
