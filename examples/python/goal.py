"""A goal for a running system, from any program: the command `scanloop set`.

    from goal import set_goal               # of the wheel: from scanloop.goal import set_goal

    first_scan = set_goal(8.0, 0.4)         # [m]; without an id the system of SCANLOOP_SYSTEM_ID

It waits for the answer, so no process of the loop calls it between two scans. The executable is that of the variable SCANLOOP,
else `scanloop` in PATH.
"""

import json
import os
import subprocess


class Refused(Exception):
    """The goal is not taken; with the reason."""


def set_goal(x_m: float, y_m: float, yaw_rad: float | None = None, system_id: str | None = None) -> int:
    """Sets place and direction of the goal that is driven to; without a direction that of the goal stays.

    Returns the first scan for which it counts; raises Refused."""
    options = ["--system-id", system_id] if system_id else []
    command = [os.environ.get("SCANLOOP", "scanloop"), *options, "set", "--json"]
    command += [f"goal.x_m={float(x_m)}", f"goal.y_m={float(y_m)}"]
    command += [f"goal.yaw_rad={float(yaw_rad)}"] if yaw_rad is not None else []
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    if done.returncode != 0:
        raise Refused(done.stderr.strip().removeprefix("error: "))
    return json.loads(done.stdout)["from_scan"]
