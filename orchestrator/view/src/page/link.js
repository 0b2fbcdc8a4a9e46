// The connection of this window to the server, while it is seen.

import { answered, Refused, request, stream } from "./stream.js";

const RETRY_MS = 2000;

const fragment = new URLSearchParams(location.hash.slice(1));
const token = fragment.get("token") ?? "";

/** A request of this page, with the token of its link. */
export const ask = (path, options) => request(token, path, options);

/** Whether the link carried a token. */
export const hasToken = token !== "";

/** The time of a recording that the link names, `t=12.5` [s]; null without one. */
export const startTime = Number.isFinite(parseFloat(fragment.get("t"))) ? parseFloat(fragment.get("t")) : null;

let own = null;

/** A request that must not wait for a connection: where this window has a stream of its own, its connection is freed. */
export async function urgent(path, options) {
  own?.close();
  try {
    return await ask(path, options);
  } finally {
    if (!document.hidden) own?.open();
  }
}

/** Calls `on.system`, `on.events` and `on.frame` with what comes, `on.open` with the past, `on.lost` with a reason. */
export function connect(on) {
  // What comes before the past is there waits.
  let waiting = [];
  let session = 0;

  async function fetchPast() {
    const mine = ++session;
    waiting = [];
    try {
      const past = await (await answered(ask("/history"))).json();
      if (mine !== session) return;
      on.open(past);
      waiting.forEach(([kind, value]) => on[kind]?.(value));
      waiting = null;
    } catch (error) {
      if (mine !== session) return;
      on.lost(error instanceof Refused ? error.message : "the server does not answer");
      setTimeout(() => { if (mine === session) fetchPast(); }, RETRY_MS);
    }
  }

  function take([kind, value]) {
    if (kind === "open") {
      fetchPast();
    } else if (kind === "lost") {
      session++;
      on.lost(value);
    } else if (waiting) {
      waiting.push([kind, value]);
    } else {
      on[kind]?.(value);
    }
  }

  const source = shared(take) ?? (own = stream(token, take));
  document.addEventListener("visibilitychange", () => { if (document.hidden) source.close(); else source.open(); });
  // A page that the browser keeps for its back button would keep its connection, too.
  addEventListener("pagehide", source.close);
  addEventListener("pageshow", (event) => { if (event.persisted) source.open(); });
  if (!document.hidden) source.open();
}

// The stream that all windows share; null where the browser can't share one.
function shared(take) {
  if (!globalThis.SharedWorker) return null;
  const { port } = new SharedWorker("/worker.js", { type: "module", name: token });
  port.onmessage = ({ data }) => take(data);
  return { open: () => port.postMessage(true), close: () => port.postMessage(false) };
}
