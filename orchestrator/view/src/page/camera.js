// Which part of the plane the map shows: follows the robot, or is moved by mouse, touch and keys.

import { sizeOf } from "./charts.js";

// Ten kilometres on a small screen.
const MIN_SCALE = 0.02;
const MAX_SCALE = 400;
// A pointer that moves less is a click.
const MAX_CLICK_PX = 4;

/** A camera over a canvas; calls `changed` when it has moved by hand, and `clicked` with a place of the plane. */
export function camera(canvas, changed, clicked) {
  const now = { x: 2, y: 0, scale: 90 };
  const goal = { ...now };
  let follows = true;
  let isSet = false;
  const pointers = new Map();
  // Where the only pointer went down, until it has moved.
  let pressed = null;

  const size = () => sizeOf(canvas);
  const clamp = (scale) => Math.min(MAX_SCALE, Math.max(MIN_SCALE, scale));

  function toScreen(x, y) {
    const [width, height] = size();
    return [width / 2 + (x - now.x) * now.scale, height / 2 - (y - now.y) * now.scale];
  }

  function toPlane(px, py) {
    const [width, height] = size();
    return [now.x + (px - width / 2) / now.scale, now.y - (py - height / 2) / now.scale];
  }

  function zoom(factor, px, py) {
    const [width, height] = size();
    const [x, y] = follows ? [goal.x, goal.y] : toPlane(px ?? width / 2, py ?? height / 2);
    const scale = clamp(goal.scale * factor);
    if (!follows) {
      goal.x = x - (x - now.x) * (now.scale / scale);
      goal.y = y - (y - now.y) * (now.scale / scale);
    }
    goal.scale = scale;
    Object.assign(now, goal);
    changed();
  }

  function release() {
    follows = false;
    Object.assign(goal, now);
  }

  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * 0.0015), event.offsetX, event.offsetY);
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    pressed = pointers.size === 1 && event.button === 0 ? [event.offsetX, event.offsetY] : null;
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const here = [event.offsetX, event.offsetY];
    if (pressed) {
      if (Math.hypot(here[0] - pressed[0], here[1] - pressed[1]) < MAX_CLICK_PX) return;
      pressed = null;
    }
    if (pointers.size === 1) {
      release();
      now.x -= (here[0] - before[0]) / now.scale;
      now.y += (here[1] - before[1]) / now.scale;
      Object.assign(goal, now);
      changed();
    } else if (pointers.size === 2) {
      const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
      const distance = (point) => Math.hypot(point[0] - other[0], point[1] - other[1]);
      zoom(distance(here) / Math.max(1, distance(before)), (here[0] + other[0]) / 2, (here[1] + other[1]) / 2);
    }
    pointers.set(event.pointerId, here);
  });
  canvas.addEventListener("pointerup", () => {
    if (pressed) clicked(toPlane(...pressed));
    pressed = null;
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, (event) => pointers.delete(event.pointerId));
  }

  return {
    toScreen,
    toPlane,
    zoom,
    get scale() { return now.scale; },
    get follows() { return follows; },
    set follows(on) { follows = on; changed(); },
    /** Shows the part of the plane between these bounds, below the buttons. */
    fit([x0, x1], [y0, y1]) {
      const [width, height] = size();
      release();
      const scale = clamp(Math.min((width - 60) / Math.max(1, x1 - x0), (height - 90) / Math.max(1, y1 - y0)));
      Object.assign(goal, { x: (x0 + x1) / 2, y: (y0 + y1) / 2 + 15 / scale, scale });
      changed();
    },
    /** Moves towards its goal; returns whether it still moves. */
    step(seconds, body, centre_y) {
      if (follows && body) {
        const [width] = size();
        // The robot stands left of the middle: what matters lies ahead of it.
        goal.x = body.x_m + (0.16 * width) / goal.scale;
        goal.y = centre_y + Math.max(-1, Math.min(1, body.y_m - centre_y)) * 0.5;
        if (!isSet) {
          goal.scale = clamp(width / 8.4);
          Object.assign(now, goal);
          isSet = true;
        }
      }
      const share = 1 - Math.exp(-seconds / 0.12);
      let far = 0;
      for (const key of ["x", "y", "scale"]) {
        const left = goal[key] - now[key];
        far = Math.max(far, Math.abs(left) * (key === "scale" ? 1 : now.scale));
        now[key] += left * share;
      }
      return far > 0.3;
    },
  };
}
