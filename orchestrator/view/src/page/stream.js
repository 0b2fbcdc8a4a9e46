// The connection to the server: a stream of events that is opened again after a loss, and closed while the page is hidden.

const RETRY_MS = [300, 600, 1200, 2000];
// The server sends something each second.
const SILENCE_MS = 4000;

const fragment = new URLSearchParams(location.hash.slice(1));
const token = fragment.get("token") ?? "";

/** A request of this page, with the token of its link. */
export function ask(path, options = {}) {
  const headers = { ...options.headers };
  if (token) headers.Authorization = `Bearer ${token}`;
  return fetch(path, { ...options, headers, credentials: "omit" });
}

/** Whether the link carried a token. */
export const hasToken = token !== "";

/** The time of a recording that the link names, `t=12.5` [s]; null without one. */
export const startTime = Number.isFinite(parseFloat(fragment.get("t"))) ? parseFloat(fragment.get("t")) : null;

class Refused extends Error {}

/** Calls `on.system`, `on.events` and `on.frame` with what comes, `on.open` with the past, `on.lost` with a reason. */
export function connect(on) {
  let abort = null;
  let failures = 0;
  let timer = 0;

  // An answer that is no refusal; a refusal is the reason that is shown.
  async function answered(asked) {
    const response = await asked;
    if (!response.ok) throw new Refused((await response.text()).trim().slice(0, 120));
    return response;
  }

  async function open() {
    clearTimeout(timer);
    if (document.hidden || abort) return;
    const mine = new AbortController();
    abort = mine;
    let reason = "the server does not answer";
    let silence = 0;
    const alive = () => {
      clearTimeout(silence);
      silence = setTimeout(() => mine.abort(), SILENCE_MS);
    };
    try {
      alive();
      // The past first: it needs a connection, of which a browser has six, and the stream keeps one.
      const past = await answered(ask("/history", { signal: mine.signal }));
      on.open(await past.json());
      const response = await answered(ask("/stream", { signal: mine.signal }));
      alive();
      failures = 0;
      const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
      let rest = "";
      for (;;) {
        const { value, done } = await reader.read();
        if (done) break;
        alive();
        const blocks = (rest + value).split("\n\n");
        rest = blocks.pop();
        blocks.forEach(deliver);
      }
    } catch (error) {
      if (error instanceof Refused) reason = error.message;
    }
    clearTimeout(silence);
    if (abort === mine) abort = null;
    if (document.hidden) return;
    on.lost(reason);
    timer = setTimeout(open, RETRY_MS[Math.min(failures++, RETRY_MS.length - 1)]);
  }

  function deliver(block) {
    const [first, second] = block.split("\n");
    if (!first.startsWith("event: ") || !second?.startsWith("data: ")) return;
    on[first.slice(7)]?.(JSON.parse(second.slice(6)));
  }

  function close() {
    abort?.abort();
    abort = null;
  }

  document.addEventListener("visibilitychange", () => { if (document.hidden) close(); else open(); });
  // A page that the browser keeps for its back button would keep its connection, too.
  addEventListener("pagehide", close);
  addEventListener("pageshow", (event) => { if (event.persisted) open(); });
  open();
}
