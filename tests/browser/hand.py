"""Arrows of the live page: hand.py URL TOKEN STATUS-COMMAND...

Checks that an arrow drives while it is pressed: until it is released, and until the connection is lost.
"""

import json
import subprocess
import sys
import time

from browser import Browser

LOST = {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}


def wait_for(what, command, expected, timeout_s=30):
    """Waits until `status --json` has who drives, and whether the wheels turn."""
    until = time.monotonic() + timeout_s
    while True:
        status = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
        found = status["driven_by"], status["wheels"] == "turning"
        if found == expected:
            return
        assert time.monotonic() < until, (what, found)
        time.sleep(0.05)


def main():
    url, token, command = sys.argv[1], sys.argv[2], sys.argv[3:]
    with Browser() as browser:
        browser.call("Emulation.setFocusEmulationEnabled", enabled=True)
        browser.go(f"{url}#token={token}")
        browser.wait("document.querySelectorAll('button.hand').length === 3")
        x, y = browser.value(
            "(() => { const b = document.querySelectorAll('button.hand')[1]; b.scrollIntoView();"
            "const r = b.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()")

        def mouse(kind):
            browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

        mouse("mousePressed")
        wait_for("a pressed arrow drives", command, ("person", True))
        mouse("mouseReleased")
        wait_for("a released arrow stands", command, ("nobody", False))
        mouse("mousePressed")
        wait_for("it drives again", command, ("person", True))
        browser.call("Network.enable")
        browser.call("Network.emulateNetworkConditions", **LOST)
        wait_for("without a connection it stands", command, ("nobody", False))


if __name__ == "__main__":
    main()
