// Control: stop, pause, resume, teleop, restart, swap, set, goal and inject, each with its certificate or its refusal.

import { ask, hasToken, urgent } from "./link.js";

// A button that is held asks so often, and steers so far to a side [rad]; the system limits it.
const HOLD_MS = 50;
const HAND_RAD = 0.05;
const ROLES = ["estimator", "obstacles", "controller", "actuator", "robot"];

/** The panel, and the button that stops: `show` takes what the server allows, `click` a place on the map. */
export function control(panel, form, result, stop) {
  let allowed = "";
  // While it is pressed, a click on the map sets the goal.
  const aim = Object.assign(document.createElement("button"), {
    type: "button", textContent: "goal", className: "goal", title: "Set the goal that is next: then click its place on the map",
  });
  const press = (on) => {
    aim.setAttribute("aria-pressed", String(on));
    document.body.classList.toggle("aiming", on);
  };
  aim.addEventListener("click", () => press(aim.getAttribute("aria-pressed") !== "true"));

  async function send(action, button) {
    button.disabled = true;
    result.hidden = false;
    result.textContent = `${action.action} …`;
    try {
      const send = ["stop", "pause"].includes(action.action) ? urgent : ask;
      const response = await send("/control", { method: "POST", body: JSON.stringify(action), headers: { "Content-Type": "application/json" } });
      const text = await response.text();
      result.textContent = response.ok ? describe(JSON.parse(text)) : `refused: ${text}`;
    } catch (error) {
      result.textContent = `not sent: ${error.message}`;
    }
    button.disabled = false;
  }

  const input = (name, title) => Object.assign(document.createElement("input"), { name, placeholder: title, title });
  const roles = () => {
    const select = document.createElement("select");
    select.title = "role";
    select.append(...ROLES.map((role) => new Option(role)));
    return select;
  };

  function group(name, parts, build) {
    const button = Object.assign(document.createElement("button"), { type: "button", textContent: name, className: name });
    button.addEventListener("click", () => send({ action: name, ...build() }, button));
    form.append(...parts, button);
  }

  // Buttons that drive while they are held, in this window and with the focus.
  function hand() {
    const speed = Object.assign(input("speed", "m/s"), { value: "0.3", title: "velocity by hand [m/s]" });
    let held = null, timer = 0, inFlight = false;
    const post = async (body) => {
      try {
        const response = await ask("/control", { method: "POST", body: JSON.stringify({ action: "teleop", ...body }), headers: { "Content-Type": "application/json" } });
        if (!response.ok) { release(); result.hidden = false; result.textContent = `refused: ${await response.text()}`; }
      } catch (error) {
        release();
      }
    };
    const give = async () => {
      if (inFlight || held === null) return;
      inFlight = true;
      await post({ velocity: Math.max(0, Number(speed.value) || 0), steering: held });
      inFlight = false;
    };
    const release = () => {
      if (held === null) return;
      held = null;
      clearInterval(timer);
      post({});
    };
    const button = (name, title, steering) => {
      const made = Object.assign(document.createElement("button"), { type: "button", textContent: name, className: "hand", title });
      made.addEventListener("pointerdown", (event) => {
        made.setPointerCapture(event.pointerId);
        held = steering;
        clearInterval(timer);
        timer = setInterval(give, HOLD_MS);
        give();
      });
      for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) made.addEventListener(end, release);
      return made;
    };
    addEventListener("blur", release);
    addEventListener("pagehide", release);
    document.addEventListener("visibilitychange", release);
    return [speed, button("◀", "drive to the left while held", HAND_RAD), button("▲", "drive straight while held", 0), button("▶", "drive to the right while held", -HAND_RAD)];
  }

  function show(actions) {
    const wanted = hasToken ? actions : [];
    if (wanted.join() === allowed) return;
    allowed = wanted.join();
    panel.hidden = wanted.length === 0;
    document.body.classList.toggle("controlled", !panel.hidden);
    form.replaceChildren();
    const has = (name) => wanted.includes(name);
    // It stands where it is always seen.
    stop.hidden = !has("stop");
    stop.onclick = () => send({ action: "stop" }, stop);
    if (has("pause")) group("pause", [], () => ({}));
    if (has("resume")) group("resume", [], () => ({}));
    if (has("teleop")) form.append(...hand());
    const [role, to] = [roles(), input("to", "implementation")];
    if (has("restart")) group("restart", [role], () => ({ role: role.value }));
    if (has("swap")) group("swap", [to], () => ({ role: role.value, to: to.value }));
    const [key, value] = [input("key", "controller.theta_m"), input("value", "value")];
    if (has("set")) group("set", [key, value], () => ({ key: key.value, value: value.value }));
    press(false);
    if (has("goal")) form.append(aim);
    const fault = input("fault", "fault");
    if (has("inject")) group("inject", [fault], () => ({ fault: fault.value }));
  }

  function click([x, y]) {
    if (aim.getAttribute("aria-pressed") !== "true") return;
    press(false);
    const centimetres = (metres) => Math.round(metres * 100) / 100;
    send({ action: "goal", x_m: centimetres(x), y_m: centimetres(y) }, aim);
  }

  return { show, click };
}

function describe({ action, exit_code: code, certificate, messages }) {
  const lines = [`${action}: ${code === 0 ? "done" : `exit code ${code}`}`];
  // The messages have a certificate as a sentence.
  if (certificate && typeof certificate !== "object") lines.push(certificate);
  if (messages) lines.push(messages);
  return lines.join("\n");
}
