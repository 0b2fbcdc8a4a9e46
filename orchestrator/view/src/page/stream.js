// The stream of a browser: opened again after a loss, for as long as it is wanted. A browser has few connections to one
// server, so all its windows share one stream where it can share (worker.js), and others stay free for a stop.

const RETRY_MS = [300, 600, 1200, 2000];
// The server sends something each second.
const SILENCE_MS = 4000;

/** A refusal of the server, with its reason. */
export class Refused extends Error {}

/** A request with the token of a link. */
export async function request(token, path, options = {}) {
  const headers = { ...options.headers };
  if (token) headers.Authorization = `Bearer ${token}`;
  return fetch(path, { ...options, headers, credentials: "omit" });
}

/** The answer, or [`Refused`]. */
export async function answered(asked) {
  const response = await asked;
  if (!response.ok) throw new Refused((await response.text()).trim().slice(0, 120));
  return response;
}

/** Calls `tell` with `["open"]`, `["lost", reason]` and `[event, value]`; returns functions that open and close. */
export function stream(token, tell) {
  let abort = null;
  let failures = 0;
  let timer = 0;
  let isWanted = false;

  async function run() {
    clearTimeout(timer);
    if (!isWanted || abort) return;
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
      const response = await answered(request(token, "/stream", { signal: mine.signal }));
      alive();
      failures = 0;
      tell(["open"]);
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
    if (!isWanted) return;
    tell(["lost", reason]);
    timer = setTimeout(run, RETRY_MS[Math.min(failures++, RETRY_MS.length - 1)]);
  }

  function deliver(block) {
    const [first, second] = block.split("\n");
    if (!first.startsWith("event: ") || !second?.startsWith("data: ")) return;
    tell([first.slice(7), JSON.parse(second.slice(6))]);
  }

  return {
    open() {
      isWanted = true;
      run();
    },
    close() {
      isWanted = false;
      abort?.abort();
      abort = null;
    },
  };
}
