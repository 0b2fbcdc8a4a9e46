"""A person who drives a running system by hand, for a program: a process of `scanloop teleop --stdin`.

    from person import Person               # of the wheel: from scanloop.person import Person

    with Person("lab") as person:           # takes over; without an id the system of SCANLOOP_SYSTEM_ID
        for _ in range(40):
            person.give(0.3, 0.02)          # [m/s], [rad] to the left
            time.sleep(0.05)
        person.resume()                     # else the drive is paused at the end

Without a new control within 1.5 scan periods the wheels are blocked. The executable is that of the variable SCANLOOP, else
`scanloop` in PATH.
"""

import os
import subprocess


class Refused(Exception):
    """The person does not drive; with the reason."""


class Person:
    """A person who drives by hand. Closing it pauses the drive, unless it has handed back."""

    def __init__(self, system_id: str | None = None):
        options = ["--system-id", system_id] if system_id else []
        command = [os.environ.get("SCANLOOP", "scanloop"), *options, "teleop", "--stdin"]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
        self._wait_for("by hand")

    def give(self, velocity_mps: float, steering_rad: float) -> None:
        """Asks for a velocity and a steering angle; raises Refused once it does not drive any more."""
        self._send(f"{float(velocity_mps)} {float(steering_rad)}")

    def pause(self) -> None:
        """Blocks the wheels until the next control."""
        self._send("pause")
        self._wait_for("paused")

    def resume(self) -> None:
        """Hands back to the controller."""
        self._send("resume")
        self._wait_for("resumed")
        self.close()

    def close(self) -> None:
        """Pauses the drive, unless it was handed back."""
        self._process.communicate()

    def __enter__(self) -> "Person":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _send(self, line: str) -> None:
        try:
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()
        except (BrokenPipeError, ValueError):
            raise self._refusal() from None

    def _wait_for(self, word: str) -> None:
        if self._process.stdout.readline().strip() != word:
            raise self._refusal()

    def _refusal(self) -> Refused:
        _, text = self._process.communicate()
        return Refused(text.strip().removeprefix("error: ") or "this person does not drive any more")
