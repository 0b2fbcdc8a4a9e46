#!/usr/bin/env python3
"""Drives scenarios along a line, computes the optimum with the lags of the robot, and says what each cause costs.

    cargo build --release && benches/peers/setup.sh
    benches/peers/.venv/bin/python benches/peers/ride_split.py target/release/scanloop [SCENARIO...]

The optimum is that of `course_optimum.py`: model, lags and delay of the robot, exact outlines, the smallest clearance of the
drive. Each column of the table is a factor: J of the drive is their product with J of the optimum without lags that knows
everything and keeps 0.16 m. A Markdown table goes to standard output: it is the one of docs/ride.md. Exit code 1 if a drive
does not reach its goal, or IPOPT finds no solution.
"""

import os
import subprocess
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from course_drive import Drive, second_differences
from course_optimum import Setting, optimum

SCENARIOS = ["corridor", "two-obstacles", "slalom", "walls", "noisy", "imperfect-robot", "long", "crossing"]
CLEARANCE_M = 0.16
# What is taken from a robot without noise.
QUIET = ["noise.range_m=0", "noise.dropout=0", "robot.gyro_noise_rad=0", "robot.gyro_bias_walk_radps=0",
         "robot.odometry_longitudinal=0", "robot.encoder_slip_m=0", "robot.command_jitter_s=0", "robot.scan_stamp_jitter_s=0"]
MOVING = "crossing"
PRESETS = ["ideal", "summit"]


def recorded(program, scenario, preset, changes, folder):
    """The folder of a drive of a scenario, in lock-step, with its samples as tables."""
    (home := folder / "runtime").mkdir(0o700, parents=True)
    environment = {**os.environ, "SCANLOOP_RUNTIME_DIR": str(home)}
    sets = [part for change in [f"robot.preset={preset}", *changes] for part in ("--set", change)]
    subprocess.run([program, "run", scenario, "--lockstep", "--record", "--out", folder / "out", "--quiet", "--system-id",
                    f"split-{os.getpid()}", *sets], check=True,
                   stdout=subprocess.DEVNULL, env=environment)
    subprocess.run([program, "recording", "export", folder / "out/recording.mcap", "--csv", folder / "out/csv"], check=True,
                   stdout=subprocess.DEVNULL)
    return folder / "out"


def driven(program, scenario, preset, changes, folder):
    """The drive of a scenario, in lock-step."""
    return Drive(recorded(program, scenario, preset, changes, folder))


def row(task):
    """The cells of a scenario with a preset; None if something has no solution."""
    program, scenario, preset = task
    with tempfile.TemporaryDirectory() as folder:
        drive = driven(program, scenario, preset, [], Path(folder) / "drive")
        quiet = driven(program, scenario, preset, QUIET, Path(folder) / "quiet")
    lags = drive.scenario["robot"]["velocity_lag_s"] > 0
    settings = [Setting(lags, drive.clearance, late=True), Setting(lags, drive.clearance), Setting(lags, CLEARANCE_M),
                Setting(False, CLEARANCE_M)]
    solutions, guess = [], (None, None)
    for setting in settings:
        solutions.append(optimum(drive, setting, *guess))
        guess = solutions[-1][2:4]
    known, _, near, free = [solution[0] for solution in solutions]
    messages = {solution[1] for solution in solutions}
    noise = drive.objective / quiet.objective
    jumps = second_differences([control for _, control in drive.commands]) / second_differences(solutions[0][3])
    step = max(abs(b[1] - a[1]) for (_, a), (_, b) in zip(drive.commands, drive.commands[1:]))
    cells = [f"{drive.objective / known:.3f}", f"{noise:.3f}", f"{known / near:.2f}",
             f"{near / free:.2f}", f"{jumps:.2f}", f"{step:.3f}"]
    return drive.objective / known, cells, messages - {"Solve_Succeeded"}


def main(program, *scenarios):
    print("| drive | regret | of it noise | margin | lags | second differences | largest step [rad] |")
    print("|---|" + "---:|" * 6)
    scenarios = scenarios or SCENARIOS
    tasks = [(program, scenario, preset) for scenario in scenarios for preset in PRESETS]
    failed, still = False, []
    with ProcessPoolExecutor(2) as pool:
        results = pool.map(row, tasks)
        for scenario in scenarios:
            pair = [next(results) for _ in PRESETS]
            print(f"| `{scenario}` | " + " | ".join("/".join(cell) for cell in zip(*(cells for _, cells, _ in pair))) + " |", flush=True)
            if scenario != MOVING:
                still.append([regret for regret, _, _ in pair])
            for message in set().union(*(messages for _, _, messages in pair)):
                print(f"{scenario}: {message}", file=sys.stderr)
                failed = True
    if still:
        means = "/".join(f"{sum(regrets) / len(regrets):.3f}" for regrets in zip(*still))
        print(f"| mean without `{MOVING}` | {means} |" + " |" * 5)
    return failed


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
