"""A headless Chromium that is driven over a pipe, with the standard library of Python only."""

import base64
import json
import os
import select
import shutil
import subprocess
import tempfile
import time

NAMES = ("chromium", "chromium-browser", "google-chrome")


def executable():
    """Path of a Chromium, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One browser with one tab; ends with the `with` block."""

    def __init__(self, width=1280, height=720, dark=False, mobile=False):
        self.profile = tempfile.mkdtemp(prefix="scanloop-browser-")
        to_read, self.to = os.pipe()
        self.back, back_write = os.pipe()

        def pipes():
            # The browser reads commands from descriptor 3 and answers on 4.
            first, second = os.dup(to_read), os.dup(back_write)
            os.dup2(first, 3)
            os.dup2(second, 4)

        arguments = [
            executable(), "--headless=new", "--remote-debugging-pipe", "--no-first-run", "--disable-gpu",
            "--disable-extensions", "--disable-background-networking", "--disable-component-update",
            "--hide-scrollbars", f"--user-data-dir={self.profile}", "about:blank",
        ]
        if os.geteuid() == 0:
            arguments.insert(1, "--no-sandbox")
        self.process = subprocess.Popen(
            arguments, preexec_fn=pipes, close_fds=False, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, start_new_session=True)
        os.close(to_read)
        os.close(back_write)
        self.rest, self.number, self.events, self.sessions = b"", 0, [], []
        self.session = self.open()
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=mobile)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def open(self):
        """Opens another tab; commands go to it from now on."""
        target = self.call("Target.createTarget", session=False, url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", session=False, targetId=target, flatten=True)
        self.session = attached["sessionId"]
        self.sessions.append(self.session)
        self.call("Page.enable")
        self.call("Runtime.enable")
        self.call("Log.enable")
        return self.session

    def __enter__(self):
        return self

    def __exit__(self, *_):
        try:
            self.call("Browser.close", session=False)
        except (OSError, RuntimeError):
            pass
        try:
            self.process.wait(5)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        os.close(self.to)
        os.close(self.back)
        shutil.rmtree(self.profile, ignore_errors=True)

    def call(self, method, session=True, timeout_s=20, **parameters):
        """Sends one command and returns its result."""
        self.number += 1
        number = self.number
        message = {"id": number, "method": method, "params": parameters}
        if session:
            message["sessionId"] = self.session
        os.write(self.to, json.dumps(message).encode() + b"\0")
        until = time.monotonic() + timeout_s
        while True:
            answer = self._next(until)
            if answer.get("id") == number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            if "method" in answer:
                self.events.append(answer)

    def _next(self, until):
        while b"\0" not in self.rest:
            ready, _, _ = select.select([self.back], [], [], max(0, until - time.monotonic()))
            if not ready:
                raise RuntimeError("the browser does not answer")
            piece = os.read(self.back, 1 << 20)
            if not piece:
                raise RuntimeError("the browser has ended")
            self.rest += piece
        message, self.rest = self.rest.split(b"\0", 1)
        return json.loads(message)

    def go(self, url):
        """Loads a page."""
        self.call("Page.navigate", url=url)

    def note_texts(self):
        """Has pages keep the texts that they draw: `drawn[ID OF A CANVAS]` has text and place of each since it was cleared."""
        self.call("Page.addScriptToEvaluateOnNewDocument", source="""
            window.drawn = {};
            const { fillText, clearRect } = CanvasRenderingContext2D.prototype;
            CanvasRenderingContext2D.prototype.clearRect = function (...box) {
                drawn[this.canvas.id] = [];
                clearRect.apply(this, box);
            };
            CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
                drawn[this.canvas.id]?.push([text, x, y]);
                fillText.call(this, text, x, y);
            };""")

    def value(self, expression):
        """The value of a JavaScript expression."""
        found = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise RuntimeError(f"{expression}: {found['exceptionDetails']}")
        return found["result"].get("value")

    def wait(self, expression, timeout_s=20):
        """Waits until an expression is true; returns its value. While a page loads, it may fail."""
        until = time.monotonic() + timeout_s
        while True:
            try:
                value, reason = self.value(expression), "it is not true"
            except RuntimeError as error:
                value, reason = None, error
            if value:
                return value
            if time.monotonic() > until:
                raise RuntimeError(f"not within {timeout_s} s: {expression}: {reason}")
            select.select([], [], [], 0.05)

    def screenshot(self, path):
        """Writes what the tab shows as PNG."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        with open(path, "wb") as file:
            file.write(base64.b64decode(data))

    def complaints(self):
        """Errors that pages have logged."""
        found = []
        for event in self.events:
            if event["method"] == "Runtime.exceptionThrown":
                found.append(event["params"]["exceptionDetails"])
            if event["method"] == "Log.entryAdded" and event["params"]["entry"]["level"] == "error":
                found.append(event["params"]["entry"])
        return found
