"""A recording in a browser, from a server or as a page of `report`: recording.py URL GOAL_M

Checks that it plays to its end and stops there, that pause, speed, keys and the time axis do what they say, that control
is not offered, and that what is shown can be read: the whole course, axes with units, and every text.
"""

import sys
import time

from browser import Browser

TIME = "(() => { const [m, s] = document.getElementById('clock').textContent.split(' / ')[0].split(':'); return 60 * m + +s; })()"
END = "(() => { const [m, s] = document.getElementById('clock').textContent.split(' / ')[1].split(':'); return 60 * m + +s; })()"
SCAN = "+(document.getElementById('run').textContent.match(/scan (\\d+)/)?.[1] ?? 0)"
IS_PLAYING = "document.getElementById('play').getAttribute('aria-pressed') === 'true'"


# Where the map shows a place, by the labels of its grid: the first and last x in sight [m].
SIGHT = """(() => {
    const lines = drawn.map.filter(([, , y]) => y === drawn.map[0][2]).map(([text, x]) => [+text, x - 3]);
    const [[low, left], [high, right]] = [lines[0], lines.at(-1)];
    const at = (x) => low + (high - low) * (x - left) / (right - left);
    return [at(0), at(document.getElementById('map').clientWidth)];
})()"""
# Texts that are cut, of those that have no title.
CUT = """Array.from(document.querySelectorAll('header > *, h2 span, #events b, #legend div'))
    .filter((one) => one.scrollWidth > one.clientWidth + 1 && one.clientWidth && !one.title).map((one) => one.textContent)"""


def can_be_read(browser, goal_m):
    """Checks the map after Fit, the axes of the charts, and texts, in a window of any width."""
    width = browser.value("innerWidth")
    browser.value("document.getElementById('fit').click()")
    # From the start of a path to its goal, with the body of the robot and a margin.
    fits = f"(([from, to]) => from < 0 && from > -2 && to > {goal_m} && to < {goal_m} + 2)({SIGHT})"
    browser.wait(fits)
    texts = browser.value("drawn.charts.map(([text]) => text)")
    for label in ("0 m/s", "1 m/s", "-0.06 rad", "0 rad", "0.06 rad", "0 m", "1 m"):
        assert label in texts, (width, label, texts)
    browser.value("document.getElementById('legend').hidden = false")
    cut = browser.value(CUT)
    assert not cut, (width, cut)
    browser.value("document.getElementById('legend').hidden = true")


def press(browser, key, code, number, **more):
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key=key, code=code, windowsVirtualKeyCode=number, **more)


def main():
    with Browser() as browser:
        browser.note_texts()
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

        for width in (1280, 390):
            browser.call("Emulation.setDeviceMetricsOverride", width=width, height=720, deviceScaleFactor=1, mobile=False)
            can_be_read(browser, float(sys.argv[2]))
        # Of events that take more than their place the newest is seen.
        browser.value("document.getElementById('events').style.maxHeight = '30px'")
        for key, number, time_s in (("Home", 36, "0"), ("End", 35, END), ("Home", 36, "0")):
            press(browser, key, key, number)
            browser.wait(f"Math.abs({TIME} - {time_s}) < 1")
            browser.wait("(({ scrollTop, clientHeight, scrollHeight }) => scrollTop + clientHeight >= scrollHeight - 1)"
                         "(document.getElementById('events'))")
            hides = browser.value("document.getElementById('events').scrollTop > 0")
            assert hides or key == "Home", "a short list is no test"

        # The last event, the landing, tells why; the answer follows the shown time, and a key closes it.
        press(browser, "End", "End", 35)
        browser.wait(f"{TIME} > {END} - 1")
        browser.value("Array.from(document.querySelectorAll('#events li')).find((item) => item.textContent.includes('landed')).click()")
        browser.wait("/^wheels\\n+blocked: landed/m.test(document.getElementById('why-answer').innerText)")
        about = browser.value("document.getElementById('why-title').textContent")
        press(browser, "Home", "Home", 36)
        browser.wait(f"document.getElementById('why-title').textContent === 'Why, scan ' + {SCAN}")
        assert about != browser.value("document.getElementById('why-title').textContent"), about
        press(browser, "w", "KeyW", 87)
        browser.wait("document.getElementById('why').hidden")

        # Sixteen times as fast, to the end, and from the start again.
        browser.value("(() => { document.getElementById('speed').value = '16'; document.getElementById('play').click(); })()")
        browser.wait(f"!({IS_PLAYING}) && {TIME} > {END} - 1")
        browser.wait("document.body.dataset.state === 'landed' || document.body.dataset.state === 'stopping'")
        browser.value("(() => { document.getElementById('speed').value = '0.25'; document.getElementById('play').click(); })()")
        browser.wait(f"{IS_PLAYING} && {TIME} < 2 && {SCAN} < 20")
        assert not browser.complaints(), browser.complaints()


if __name__ == "__main__":
    main()
