"""The live page over a long time: hour.py URL SECONDS; prints what it uses as one line of JSON each ten seconds."""

import json
import sys
import time

from browser import Browser

PAUSE_S = 10


def resident_kib(pid):
    """Memory of a process that it does not share [KiB]."""
    with open(f"/proc/{pid}/status") as status:
        return next((int(line.split()[1]) for line in status if line.startswith("RssAnon:")), 0)


def main():
    url, duration_s = sys.argv[1], float(sys.argv[2])
    with Browser() as browser:
        browser.go(url)
        browser.wait("document.body.dataset.state === 'driving'", 60)
        until = time.monotonic() + duration_s
        while time.monotonic() < until:
            time.sleep(PAUSE_S)
            browser.call("HeapProfiler.collectGarbage")
            heap = browser.call("Runtime.getHeapUsage")["usedSize"]
            processes = browser.call("SystemInfo.getProcessInfo", session=False)["processInfo"]
            renderers = [one["id"] for one in processes if one["type"] == "renderer"]
            print(json.dumps({
                "heap_kib": heap // 1024,
                "renderer_kib": sum(map(resident_kib, renderers)),
                "nodes": browser.value("document.getElementsByTagName('*').length"),
                "scan": browser.value("+(document.getElementById('run').textContent.match(/scan (\\d+)/)?.[1] ?? 0)"),
                "paint_ms": browser.value("+(document.body.dataset.paintP95Ms ?? 0)"),
            }), flush=True)
            browser.events.clear()


if __name__ == "__main__":
    main()
