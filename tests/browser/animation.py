"""Films the live page: animation.py URL FILE.webp SECONDS [WIDTH HEIGHT]

Takes pictures of a page that shows a drive and joins them to one animated WebP, with the standard library only.
"""

import base64
import struct
import sys
import time

from browser import Browser

# Pictures per second, and their quality: 12 s take about 1.5 MB at 960 x 540.
RATE_HZ = 5
QUALITY = 38


def chunk(name, content):
    """One chunk of a RIFF file."""
    return name + struct.pack("<I", len(content)) + content + b"\0" * (len(content) % 2)


def three(value):
    """A number of 24 bits."""
    return struct.pack("<I", value)[:3]


def picture(webp):
    """The chunk with the pixels of a still WebP."""
    at = 12
    while at < len(webp):
        name, length = webp[at:at + 4], struct.unpack("<I", webp[at + 4:at + 8])[0]
        if name in (b"VP8 ", b"VP8L"):
            return webp[at:at + 8 + length + length % 2]
        at += 8 + length + length % 2
    raise ValueError("not a WebP picture")


def join(pictures, durations_ms, width, height):
    """The animation of these pictures, without end."""
    size = three(width - 1) + three(height - 1)
    frames = b"".join(
        chunk(b"ANMF", three(0) * 2 + size + three(duration) + b"\x02" + picture(still))
        for still, duration in zip(pictures, durations_ms))
    body = chunk(b"VP8X", b"\x02\0\0\0" + size) + chunk(b"ANIM", b"\xff\xff\xff\xff\0\0") + frames
    return b"RIFF" + struct.pack("<I", len(body) + 4) + b"WEBP" + body


def main():
    url, file, seconds = sys.argv[1], sys.argv[2], float(sys.argv[3])
    width, height = map(int, sys.argv[4:6]) if len(sys.argv) > 5 else (960, 540)
    # The page is drawn at 1280 x 720 and shown smaller.
    scale = width / 1280
    with Browser(1280, round(height / scale)) as browser:
        browser.go(url)
        browser.wait("document.body.dataset.state === 'driving'", 60)
        clip = {"x": 0, "y": 0, "width": 1280, "height": round(height / scale), "scale": scale}
        pictures, times = [], [time.monotonic()]
        end = times[0] + seconds
        while times[-1] < end:
            data = browser.call("Page.captureScreenshot", format="webp", quality=QUALITY, clip=clip)["data"]
            pictures.append(base64.b64decode(data))
            while time.monotonic() < times[-1] + 1 / RATE_HZ:
                browser.value("new Promise(requestAnimationFrame).then(() => 0)")
            times.append(time.monotonic())
    durations = [round(1000 * (after - before)) for before, after in zip(times, times[1:])]
    durations[-1] = 2000
    with open(file, "wb") as output:
        output.write(join(pictures, durations, width, height))


if __name__ == "__main__":
    main()
