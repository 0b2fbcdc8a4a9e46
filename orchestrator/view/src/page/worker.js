// One stream for all windows of a browser that show the same link. The name of this worker is the token of the link.

import { stream } from "./stream.js";

// Windows that are seen, and what a window that comes later needs.
const ports = new Set();
let isOpen = false;
const last = new Map();

const source = stream(self.name, (message) => {
  const [kind] = message;
  isOpen = kind === "open" || (isOpen && kind !== "lost");
  if (kind === "system" || kind === "frame") last.set(kind, message);
  if (kind === "open" || kind === "lost") last.clear();
  for (const port of ports) port.postMessage(message);
});

self.addEventListener("connect", ({ ports: [port] }) => {
  port.onmessage = ({ data: isSeen }) => {
    if (!isSeen) {
      ports.delete(port);
      if (ports.size === 0) source.close();
      if (ports.size === 0) isOpen = false;
      return;
    }
    ports.add(port);
    if (isOpen) [["open"], ...last.values()].forEach((message) => port.postMessage(message));
    source.open();
  };
});
