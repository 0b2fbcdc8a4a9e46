// Playback of the past: of a recording, or of the last five minutes of a running system.

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16];

/** Minutes and seconds. */
export function clock(time_s, digits = 0) {
  const step = 10 ** digits;
  const rounded = Math.round(time_s * step) / step;
  const [hours, minutes] = [Math.floor(rounded / 3600), Math.floor(rounded / 60) % 60];
  const seconds = (rounded % 60).toFixed(digits).padStart(digits ? 3 + digits : 2, "0");
  return hours ? `${hours}:${String(minutes).padStart(2, "0")}:${seconds}` : `${minutes}:${seconds}`;
}

/** The buttons; calls `choose` with a time [s] when it restarts. */
export function player(by, choose) {
  const [play, speeds, label] = [by("play"), by("speed"), by("clock")];
  let isPlaying = false;
  let range = null;
  let shown = "";

  speeds.append(...SPEEDS.map((speed) => new Option(`${speed} ×`, speed, speed === 1, speed === 1)));
  const set = (on) => {
    isPlaying = on;
    play.setAttribute("aria-pressed", String(on));
    play.title = on ? "Pause (Space)" : "Play (Space)";
  };
  const toggle = () => {
    if (!range) return;
    if (!isPlaying && range.shown_s >= range.to_s) choose(range.from_s);
    set(!isPlaying);
  };
  play.addEventListener("click", toggle);

  return {
    toggle,
    set,
    get isPlaying() { return isPlaying; },
    get speed() { return +speeds.value; },
    /** Slower or faster by one step. */
    change(by) {
      speeds.selectedIndex = Math.min(SPEEDS.length - 1, Math.max(0, speeds.selectedIndex + by));
    },
    /** The shown time after some seconds, at most the end, where it pauses. */
    step(seconds, shown_s, to_s) {
      if (!isPlaying) return shown_s;
      const next = shown_s + seconds * +speeds.value;
      if (next < to_s) return next;
      set(false);
      return to_s;
    },
    /** Shows the time of a recording; `null` hides the player. */
    show(now) {
      range = now;
      play.hidden = speeds.hidden = !now;
      label.hidden = !now?.isRecording;
      if (!now) return set(false);
      const text = `${clock(now.shown_s, 1)} / ${clock(now.to_s)}`;
      if (text !== shown) label.textContent = shown = text;
    },
  };
}
