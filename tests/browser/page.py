"""The live page in a browser: page.py URL TOKEN STATUS-COMMAND...

Checks that the page draws a drive that runs, that its figures are those of `status --json`, that ten windows are served
while one connection reads nothing, that an earlier time can be shown, that control needs the token, and that
the stop of one window does not wait for the others.
"""

import json
import socket
import subprocess
import sys
from urllib.parse import urlsplit

from browser import Browser

# What drawing may cost per frame at 95 % [ms].
MAX_PAINT_MS = 8.0
# Further windows with the page.
WINDOWS = 9


def stuck(url):
    """A connection that asks for the stream and never reads it."""
    parts = urlsplit(url)
    connection = socket.create_connection((parts.hostname, parts.port))
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.sendall(f"GET /stream HTTP/1.1\r\nHost: {parts.netloc}\r\n\r\n".encode())
    return connection


def scan(browser):
    """The scan that the page shows."""
    return int(browser.value("document.getElementById('run').textContent.match(/scan (\\d+)/)?.[1] ?? 0"))


def pixels(browser):
    """A number that changes when the map does."""
    return browser.value(
        "(() => { const c = document.getElementById('map'); const d = c.getContext('2d')"
        ".getImageData(0, 0, c.width, c.height).data; let h = 0;"
        "for (let i = 0; i < d.length; i += 16) h = (31 * h + d[i] + d[i + 1]) | 0; return h; })()")


def agrees(browser, command):
    """Whether the figures of the page are those of `status --json`."""
    status = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    titles = browser.value("Array.from(document.querySelectorAll('#loop title'), (title) => title.textContent)")
    for row in status["processes"]:
        expected = f"{row['role']}: {row['implementation']}, process {row['pid']}, {row['state']}"
        assert any(title.startswith(expected) for title in titles), (expected, titles)
    shown = browser.value("document.getElementById('run').textContent")
    assert status["scenario"] in shown and status["system_id"] in shown, (shown, status["scenario"])
    assert abs(scan(browser) - status["scan"]) <= 20, (shown, status["scan"])


def main():
    url, token, command = sys.argv[1], sys.argv[2], sys.argv[3:]
    unread = stuck(url)
    with Browser() as browser:
        browser.go(url)
        browser.wait("['driving', 'blocked'].includes(document.body.dataset.state)")
        first, before = scan(browser), pixels(browser)
        browser.wait(f"+document.getElementById('run').textContent.match(/scan (\\d+)/)[1] > {first + 5}")
        assert pixels(browser) != before, "the map does not move"
        agrees(browser, command)
        # The page measures some seconds at a time; on a machine that is busy, the first of them may be slow.
        cost_ms = browser.wait(f"+document.body.dataset.paintP95Ms < {MAX_PAINT_MS} && document.body.dataset.paintP95Ms", 60)
        print(f"95 % of the frames are drawn within {cost_ms} ms", file=sys.stderr)

        # The legend says of each shape what it bounds, as `drive.svg` does.
        legend = browser.value("document.getElementById('legend').textContent")
        for entry in ("where the centre is with 95 %", "obstacle: the body keeps out", "its ellipse: the centre keeps out", "#4: "):
            assert entry in legend, legend

        # Without the token of the link there are no buttons, and a request is refused.
        assert browser.value("document.getElementById('control').hidden")
        refused = browser.value(
            "fetch('/control', {method: 'POST', body: '{\"action\":\"stop\"}'}).then((answer) => answer.status)")
        assert refused == 403, refused

        # An earlier time, and back to now.
        browser.value("document.getElementById('timeline').focus()")
        for kind in ("keyDown", "keyUp"):
            browser.call("Input.dispatchKeyEvent", type=kind, key="ArrowLeft", code="ArrowLeft", windowsVirtualKeyCode=37)
        browser.wait("document.getElementById('state-text').textContent === 'Past'")
        browser.value("document.getElementById('live').click()")
        browser.wait("document.getElementById('state-text').textContent !== 'Past'")

        # Why: a system that is not recorded names what records it.
        browser.value("document.getElementById('why-button').click()")
        browser.wait("document.getElementById('why-answer').textContent.includes('scanloop record FILE')")
        browser.value("document.getElementById('live').click()")
        browser.wait("document.getElementById('why').hidden")

        # More windows are seen at the same time than a browser opens connections, while one connection reads nothing.
        link = f"{url}#token={token}"
        for tab in [browser.session] + [browser.open() for _ in range(WINDOWS)]:
            browser.session = tab
            browser.call("Emulation.setFocusEmulationEnabled", enabled=True)
            browser.go("about:blank")
            browser.wait("location.href === 'about:blank'")
            browser.go(link)
        for tab in browser.sessions:
            browser.session = tab
            browser.wait("document.body.dataset.state === 'driving' || document.body.dataset.state === 'blocked'")
            here = scan(browser)
            browser.wait(f"+(document.getElementById('run').textContent.match(/scan (\\d+)/)?.[1] ?? 0) > {here}")

        # The button of the last one stops the run, and its request waits for no connection.
        browser.wait("!document.getElementById('stop').hidden")
        browser.value("document.getElementById('stop').click()")
        browser.wait("document.getElementById('control-result').textContent.startsWith('stop: done')")
        waited_ms = browser.value(
            "(([entry]) => entry.requestStart - entry.startTime)("
            "performance.getEntriesByType('resource').filter((entry) => entry.name.endsWith('/control')))")
        print(f"the request of the stop waited {waited_ms:.0f} ms", file=sys.stderr)
        assert waited_ms < 1000, waited_ms
        browser.wait("document.body.dataset.state === 'over'")
        complaints = [str(one) for one in browser.complaints() if "403" not in str(one) and "404" not in str(one)]
        assert not complaints, complaints
    unread.close()


if __name__ == "__main__":
    main()
