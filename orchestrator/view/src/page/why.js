// Why the robot did what it did in the shown scan: the answer of `scanloop why`.

import { ask } from "./link.js";

// While a time is dragged nothing is asked; while another question is answered, this one waits.
const STILL_MS = 200;
const BUSY_MS = 300;
const BUSY = 409;

/** The panel. `follow` takes the shown scan, `null` while there is none to ask about. */
export function why(by) {
  const [panel, button, title, answer] = [by("why"), by("why-button"), by("why-title"), by("why-answer")];
  let wanted = null;

  const say = (text) => {
    answer.replaceChildren(Object.assign(document.createElement("dd"), { textContent: text }));
  };

  const row = ({ about, text }, before) => {
    const name = Object.assign(document.createElement("dt"), { textContent: about === before?.about ? "" : about });
    return [name, Object.assign(document.createElement("dd"), { textContent: text })];
  };

  async function fetchAnswer(scan) {
    if (scan !== wanted) return;
    try {
      const response = await ask(`/why?scan=${scan}`);
      if (response.status === BUSY) return setTimeout(() => fetchAnswer(scan), BUSY_MS);
      const found = response.ok ? await response.json() : await response.text();
      if (scan !== wanted) return;
      if (!response.ok) return say(found);
      title.textContent = `Why, scan ${found.scan}`;
      answer.replaceChildren(...found.sentences.flatMap((sentence, index, all) => row(sentence, all[index - 1])));
    } catch (error) {
      if (scan === wanted) say(`not asked: ${error.message}`);
    }
  }

  const set = (isOpen) => {
    panel.hidden = !isOpen;
    button.setAttribute("aria-expanded", String(isOpen));
    wanted = null;
    say("…");
    title.textContent = "Why";
  };
  by("why-close").addEventListener("click", () => set(false));

  return {
    get isOpen() { return !panel.hidden; },
    set,
    follow(scan) {
      if (panel.hidden || scan == null || scan === wanted) return;
      wanted = scan;
      if (title.textContent === "Why") title.textContent = `Why, scan ${scan} …`;
      setTimeout(() => fetchAnswer(scan), STILL_MS);
    },
    /** There is no answer, for this reason. */
    refuse(reason) {
      if (panel.hidden || wanted === reason) return;
      wanted = reason;
      title.textContent = "Why";
      say(reason);
    },
  };
}
