"""The estimator of the laboratory against filterpy, KISS-ICP and small_gicp; see `run`."""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import kalman
import rover
from drives import Drive, integrated
from odometers import Gicp, Kiss, follow

GROUNDS, ROBOTS, SEEDS, WAY_M = ("empty", "endless", "plain-walls", "rooms"), ("summit", "worn"), 2, 60
RECORDING = Path(__file__).resolve().parents[4] / "shared/recordings/urg-rover.dat"
SCANNER_X_M = 0.145
# Its wheels slip, and no model of the SUMMIT fits it.
ROVER = ["estimator.gate=false", "estimator.self_check=false", "estimator.odometry_longitudinal=0",
         f"vehicle.scanner_x_m={SCANNER_X_M}", "vehicle.encoder_slip_m=0.1", "vehicle.gyro_noise_rad=0.1"]
# The share of the distance that the emulated odometers do not report, as the estimator knows it.
UNREPORTED = 0.01
TURNS = 3
START, END = "<!-- peers -->", "<!-- /peers -->"


def laboratory(program, *words):
    done = subprocess.run([program, "estimator", *words], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, words))}: {done.stderr}")
    return done.stdout


def followed(program, path, keys=()):
    out = laboratory(program, "--follow", path, *(f"--set={key}" for key in keys))
    return np.array([[float(word) for word in line.split()] for line in out.splitlines()])


def ours(program, path, keys):
    rows = followed(program, path, keys)
    return rows[:, :3], rows[:, 3]


def candidates(program, keys):
    """Name, setting, and what follows a drive."""
    yield "`match`", "", lambda drive: ours(program, drive.name, keys)
    for name, kind in (("KISS-ICP", Kiss), ("small_gicp", Gicp)):
        for setting in kind.SETTINGS:
            yield name, setting, lambda drive, kind=kind, setting=setting: follow(kind(setting), drive)


def best(results):
    """Of each name the setting with the smallest figure; each result is name, setting, figure, columns."""
    names = dict.fromkeys(name for name, *_ in results)
    return [min((row for row in results if row[0] == name), key=lambda row: row[2]) for name in names]


def timed(run, drives):
    """Median over the turns of the median time per scan [us]."""
    return np.median([np.median(np.concatenate([run(drive)[1] for drive in drives])) for _ in range(TURNS)]) / 1e3


def emulated(program, folder):
    laboratory(program, "--scans", folder, "--seeds", str(SEEDS), "--way", str(WAY_M),
               *(word for ground in GROUNDS for word in ("--scenario", ground)),
               *(word for robot in ROBOTS for word in ("--robot", robot)))
    lines = ["| way | by | rms | largest | a scan |", "|---|---|---|---|---|"]
    for ground in GROUNDS:
        drives = [Drive.read(path, unreported=UNREPORTED) for path in sorted(Path(folder).glob(f"{ground}-*-match-*"))]
        results = []
        for name, setting, run in candidates(program, ()):
            errors = [drive.errors(run(drive)[0]) for drive in drives]
            rms, most = np.sqrt(np.mean([rms**2 for rms, _ in errors])), max(most for _, most in errors)
            results.append((name, setting, rms, (most, run)))
        for name, setting, rms, (most, run) in best(results):
            print(ground, name, setting, file=sys.stderr)
            lines.append(f"| `{ground}` | {name} | {rms:.3f} m | {most:.3f} m | {timed(run, drives):.0f} us |")
    return lines


def recorded(program, path, folder):
    converted = Path(folder) / "rover.txt"
    with open(converted, "w") as file:
        rover.convert(path, file)
    drive = Drive.read(converted, scanner_x_m=SCANNER_X_M)
    wheels = integrated(drive.motions)
    # The measure itself: neither may pass, however sharp they are.
    for name, poses in (("a pose that never moves", wheels * 0), ("a shrunk way", wheels * [0.9, 0.9, 1])):
        if not drive.refusal(poses):
            sys.exit(f"{name} passes")
    lines = ["| by | cells | a scan | |", "|---|---|---|---|", f"| the wheels | {drive.cells(wheels)} | | |"]
    results = []
    for name, setting, run in candidates(program, ROVER):
        poses, _ = run(drive)
        refusal = drive.refusal(poses)
        results.append((name, setting, (bool(refusal), drive.cells(poses)), (refusal, run)))
    for name, setting, (_, cells), (refusal, run) in best(results):
        print("recording", name, setting, file=sys.stderr)
        lines.append(f"| {name} | {cells} | {timed(run, [drive]):.0f} us | {refusal} |")
    return lines


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("laboratory")
    parser.add_argument("--recording", type=Path, default=RECORDING)
    parser.add_argument("--write", type=Path)
    arguments = parser.parse_args()
    program = arguments.laboratory
    with tempfile.TemporaryDirectory() as folder:
        lines = emulated(program, folder)
        path = sorted(Path(folder).glob("endless-worn-match-*"))[0]
        rows = followed(program, path, [f"estimator.{key}" for key in kalman.KEYS])
        columns = np.loadtxt(path, skiprows=1, usecols=range(5))
        worst = kalman.largest_difference(rows[:, 4:], columns[:, 2:5], columns[:, 0])
        print(f"filterpy: {worst:.1e}")
        if not worst <= kalman.TOLERANCE:
            sys.exit("the linear filter is another than that of filterpy")
        if arguments.recording.exists():
            lines += ["", *recorded(program, arguments.recording, folder)]
        else:
            print(f"skipped: no recording {arguments.recording}")
    text = "\n".join(lines)
    print(text)
    if arguments.write:
        page = arguments.write.read_text()
        before, rest = page.split(START)
        arguments.write.write_text(f"{before}{START}\n{text}\n{END}{rest.split(END)[1]}")


if __name__ == "__main__":
    main()
