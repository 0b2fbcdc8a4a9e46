// The connection to the server: a stream of events that is opened again after a loss, and closed while the page is hidden.

const RETRY_MS = [300, 600, 1200, 2000];
// The server sends something each second.
const SILENCE_MS = 4000;

const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";

/** A request of this page, with the token of its link. */
export function ask(path, options = {}) {
  const headers = { ...options.headers };
  if (token) headers.Authorization = `Bearer ${token}`;
  return fetch(path, { ...options, headers, credentials: "omit" });
}

/** Whether the link carried a token. */
export const hasToken = token !== "";

/** Calls `on.system`, `on.events` and `on.frame` with what comes, and `on.open`, `on.lost` with a reason. */
export function connect(on) {
  let abort = null;
  let failures = 0;
  let timer = 0;

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
      const response = await ask("/stream", { signal: mine.signal });
      if (!response.ok) {
        reason = (await response.text()).trim().slice(0, 120);
        throw new Error(reason);
      }
      await on.open();
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
    } catch { /* The reason is shown below. */ }
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

  document.addEventListener("visibilitychange", () => {
    if (document.hidden) {
      abort?.abort();
      abort = null;
    } else {
      open();
    }
  });
  open();
}
