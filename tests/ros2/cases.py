#!/usr/bin/env python3
"""Drives robots of ROS 2 with Scanloop, and checks what the robot saw.

usage: tests/ros2/run [CASE...]

Without a case: `minute`. With `all`: every case. One that fails while the machine is late is tried again, twice at most.
Exit code 1 if one fails.
"""

import argparse
import sys
import time
from pathlib import Path

import faults
import foreign
import latency
import person
import robots
import tools
from drive import ROOT, Failed
from machine import repeat_when_late

CASES = {
    "minute": robots.minute,
    "beams": robots.beams,
    "around": robots.around,
    "twist": robots.twist,
    "jump": robots.jump,
    "frames": robots.frames,
    "hokuyo": robots.hokuyo,
    "imu": robots.imu,
    "latency": latency.latency,
    "stall": faults.stall,
    "restart": faults.restart,
    "killed-driver": faults.killed_driver,
    "killed-guard": faults.killed_guard,
    "killed-run": faults.killed_run,
    "missing": faults.missing,
    "two": faults.two,
    "view": tools.view,
    "hand": person.hand,
    "gamepad": person.gamepad,
    "button": person.button,
    "goal": person.goal,
    "foreign": foreign.foreign,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scanloop", type=Path, default=ROOT / "target/debug/scanloop")
    parser.add_argument("--ros2", type=Path, default=ROOT / "services/ros2/target/debug/scanloop-ros2")
    # No `choices`: they refuse the default of a list.
    parser.add_argument("case", nargs="*", default=["minute"], help=f"of {', '.join(CASES)}; or all")
    options = parser.parse_args()
    for name in {*options.case} - {*CASES, "all"}:
        parser.error(f"case {name} is not one of {', '.join(CASES)}, all")
    options.scanloop, options.ros2 = options.scanloop.resolve(), options.ros2.resolve()
    failed = False
    for name in CASES if "all" in options.case else options.case:
        begun = time.monotonic()
        try:
            told, word = repeat_when_late(lambda: CASES[name](options), Failed), "passed"
        except Failed as failure:
            told, word, failed = str(failure), "FAILED", True
        print(f"{name}: {word} after {time.monotonic() - begun:.0f} s: {told}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
