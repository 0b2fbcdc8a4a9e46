"""A recording in a browser, from a server or as a page of `report`: recording.py URL

Checks that it plays to its end and stops there, that pause, speed, keys and the time axis do what they say, and that
control is not offered.
"""

import sys
import time

from browser import Browser

TIME = "(() => { const [m, s] = document.getElementById('clock').textContent.split(' / ')[0].split(':'); return 60 * m + +s; })()"
END = "(() => { const [m, s] = document.getElementById('clock').textContent.split(' / ')[1].split(':'); return 60 * m + +s; })()"
SCAN = "+(document.getElementById('run').textContent.match(/scan (\\d+)/)?.[1] ?? 0)"
IS_PLAYING = "document.getElementById('play').getAttribute('aria-pressed') === 'true'"


def press(browser, key, code, number, **more):
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key=key, code=code, windowsVirtualKeyCode=number, **more)


def main():
    with Browser() as browser:
        browser.go(sys.argv[1])
        browser.wait("document.body.dataset.state === 'driving'")
        browser.wait(f"{IS_PLAYING} && {TIME} > 0.5 && {SCAN} > 3")
        assert browser.value("document.getElementById('live').hidden && document.getElementById('control').hidden")

        press(browser, " ", "Space", 32)
        browser.wait(f"!({IS_PLAYING})")
        press(browser, "Home", "Home", 36)
        browser.wait(f"{TIME} === 0")
        press(browser, "ArrowRight", "ArrowRight", 39)
        browser.wait(f"{TIME} === 1 && {SCAN} > 5")
        press(browser, "ArrowRight", "ArrowRight", 39, modifiers=8)
        browser.wait(f"Math.abs({TIME} - 1.1) < 0.01")

        # The middle of the time axis.
        box = browser.value("(() => { const b = document.getElementById('timeline').getBoundingClientRect(); return [b.x + b.width / 2, b.y + 10]; })()")
        for kind in ("mousePressed", "mouseReleased"):
            browser.call("Input.dispatchMouseEvent", type=kind, x=box[0], y=box[1], button="left", buttons=1, clickCount=1)
        browser.wait(f"Math.abs({TIME} - {END} / 2) < 0.6")
        # Ten scans a second; the frame of that time comes a moment later.
        middle = browser.wait(f"Math.abs({SCAN} - 5 * {END}) < 15 && {SCAN}")
        time.sleep(0.5)
        assert browser.value(SCAN) == middle, "it is paused"

        # Sixteen times as fast, to the end, and from the start again.
        browser.value("(() => { document.getElementById('speed').value = '16'; document.getElementById('play').click(); })()")
        browser.wait(f"!({IS_PLAYING}) && {TIME} > {END} - 1")
        browser.wait("document.body.dataset.state === 'landed' || document.body.dataset.state === 'stopping'")
        browser.value("(() => { document.getElementById('speed').value = '0.25'; document.getElementById('play').click(); })()")
        browser.wait(f"{IS_PLAYING} && {TIME} < 2 && {SCAN} < 20")
        assert not browser.complaints(), browser.complaints()


if __name__ == "__main__":
    main()
