"""A person with the tools of ROS 2: drives by hand, presses a button, sends a goal."""

import contextlib
import json
import math
import subprocess
import sys
import time

from drive import DEADLINE_S, PERIOD_S, ROOT, Drive, driving_pid, first_zero_s, reached, require, seen

COMPANION = """
[[process]]
role = "companion"
name = "{name}"
command = ["{program}", "{name}", "domain={domain}", "interface=127.0.0.1"{more}]
{keys}
"""
BUTTON = """
[[topic]]
name = "button"
layout = "{root}/examples/python/emergency-stop/button.toml"

[[process]]
role = "actuator"
implementation = "actuation"
also_reads = [{{ topic = "button", max_age_ms = 300.0 }}]
"""
VIEW = 'reads = ["scan", "odometry", "pose", "obstacles", "command", "actuation"]'
# As the built-in vehicle has them.
STEERING_RAD = 0.06
# Without noise, a robot that is stopped while it moves has the scans of a scanner that is stuck.
NOISE = ["--noise=0.005"]


class Person:
    """Says something on topics."""

    def __init__(self, drive):
        command = [sys.executable, ROOT / "tests/ros2/speak.py"]
        pipe = subprocess.PIPE
        self.program = subprocess.Popen(command, env=drive.environment, stdin=pipe, stdout=pipe, text=True)
        drive.stack.callback(self.leave)
        require(self.program.stdout.readline() == "ready\n", "the person does not start")

    def say(self, topic, kind=None, fields=(), **more):
        """Sends a message; without a kind sends no more."""
        line = {"topic": topic, **({"kind": kind, "fields": dict(fields)} if kind else {}), **more}
        self.program.stdin.write(json.dumps(line) + "\n")
        self.program.stdin.flush()
        require(self.program.stdout.readline() == "ok\n", "the person has ended")

    def twist(self, velocity, yaw_rate, seconds, **more):
        """Drives so for a time, by a topic that is not the robot's."""
        fields = {"linear.x": velocity, "angular.z": yaw_rate}
        self.say("/person/cmd_vel", "Twist", fields, rate_hz=20.0, for_s=seconds, **more)

    def joy(self, ahead=0.0, left=0.0, held=(), **more):
        """Moves the sticks and holds buttons, by their numbers."""
        buttons = [int(number in held) for number in range(8)]
        self.say("/joy", "Joy", {"axes": [left, ahead], "buttons": buttons}, rate_hz=20.0, **more)

    def leave(self):
        """Ends the program."""
        self.program.kill()
        self.program.wait()
        self.program.stdin.close()
        self.program.stdout.close()


def add(drive, name, keys="", more=(), text=""):
    """Adds a companion, and other text, to the system file."""
    more = "".join(f', "{argument}"' for argument in more)
    program = drive.options.ros2
    added = COMPANION.format(name=name, program=program, domain=drive.domain, keys=keys, more=more)
    drive.system.write_text(drive.system.read_text() + text.format(root=ROOT) + added)


def start_emulated(drive, *arguments):
    """Starts a drive of the emulated robot."""
    drive.system.write_text(drive.system.read_text().split("[ros2]")[0] + drive.system.read_text().split('"ros2"\n')[1])
    drive.start(*arguments[1:], scenario=arguments[0])


def command(drive, *arguments):
    """Runs a command, which has to be done."""
    found = drive.scanloop(*arguments)
    require(found.returncode == 0, f"{arguments}: {found.stderr}")


def newest(drive, topic):
    """The newest sample of a topic."""
    found = drive.scanloop("topic", "echo", topic, "-n", "1", "--short", seconds=5.0)
    return json.loads(found.stdout) if found.returncode == 0 and found.stdout else {}


def drives(drive):
    """Who drives."""
    return (drive.status() or {}).get("driven_by")


def start_teleop(drive, *arguments):
    """Starts the program as a person does."""
    command = [drive.options.ros2, "teleop", f"domain={drive.domain}", "interface=127.0.0.1", *arguments]
    with open(drive.folder / "teleop", "w") as file:
        program = subprocess.Popen(command, cwd=drive.folder, env=drive.environment, stdout=file, stderr=file)

    def stop():
        if program.poll() is None:
            program.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                program.wait(10)
            program.kill()
            program.wait()

    drive.stack.callback(stop)
    return program, lambda: (drive.folder / "teleop").read_text()


def commands(found, since, until=math.inf):
    """The commands that came to a robot in a time."""
    return [event for event in found["events"] if event[0] == "command" and since <= event[1] <= until]


def hand(options):
    """A robot of ROS 2 is paused, driven around two corners by a `Twist`, stands in silence, and is resumed to its goal."""
    with Drive(options, 96, 12.0, NOISE) as drive:
        robot, report = drive.start_robot()
        drive.start()
        driving_pid(drive)
        own, said = start_teleop(drive)
        require(own.wait(DEADLINE_S) == 2, "the topic of the robot is taken for that of a person")
        require("topic = /cmd_vel is not allowed: the robot of this system" in said(), said())
        program, said = start_teleop(drive, "topic=/person/cmd_vel")
        person = Person(drive)
        command(drive, "pause")
        drive.wait("nobody drives", lambda: drives(drive) == "nobody")
        paused = time.monotonic()
        person.say("/person/cmd_vel", "Twist", {"linear.x": math.nan})
        person.twist(0.4, 0.0, 0.5)
        begun = time.monotonic()
        turns = (0.1, -0.1)
        for turn in turns:
            person.twist(0.4, turn, 2.0)
        silent = time.monotonic()
        drive.wait("a person drives", lambda: drives(drive) == "person")
        time.sleep(1.0)
        resumed = time.monotonic()
        command(drive, "resume")
        # The stream that is lost does not fight with the one who has resumed: the program ends.
        person.twist(0.4, 0.0, 1.5)
        require(program.wait(DEADLINE_S) == 2, said())
        require("this person does not drive any more" in said(), said())
        require("linear.x is nan" in said().lower(), f"the number that is none is not named: {said()}")
        code = drive.finish(60)
        found = seen(robot, report)
        reached(drive, found, code, goal=(12.0, found["y_m"]))
        stood = commands(found, paused + 2 * PERIOD_S, begun - 0.6)
        require(all(event[2] == 0.0 for event in stood), f"a command drove while it was paused: {stood}")
        driven = [event for event in commands(found, begun + 0.5, silent) if event[2] > 0.0]
        require(len(driven) > 30, f"only {len(driven)} commands of the person came")
        for turn in turns:
            same = [event for event in driven if abs(event[2] - 0.4) < 1e-3 and abs(event[3] - turn) < 1e-3]
            require(len(same) > 8, f"a yaw rate of {turn} came {len(same)} times: {driven}")
        silence = [event for event in commands(found, silent + 0.15 + 2 * PERIOD_S, resumed)]
        require(all(event[2] == 0.0 for event in silence), f"it drove on in silence: {silence}")
        changes = [change["driven_by"] for change in drive.report()["driver_changes"]]
        require(changes == ["nobody", "person", "controller"], f"{changes}")
        return f"{len(driven)} commands of the person, as asked; {abs(found['x_m'] - 12.0):.3f} m from the goal"


def gamepad(options):
    """A companion with a gamepad drives the emulated robot: the button that is held, late messages, pause and resume."""
    with Drive(options, 97, 5.0) as drive:
        add(drive, "teleop", more=["from=joy"])
        person = Person(drive)
        start_emulated(drive, "free", "--set", "goal.x_m=12")
        drive.wait("it drives", lambda: newest(drive, "actuation").get("kind") == "drive")
        person.joy(1.0, held=[4])
        time.sleep(0.5)
        require(drives(drive) == "controller", "a button that was held from the start on has taken over")
        person.joy()
        time.sleep(0.3)
        require(drives(drive) == "controller", "a stick without the button has taken over")
        person.joy(1.0, 1.0, held=[4])
        drive.wait("a person drives", lambda: newest(drive, "actuation").get("driven_by") == "person")
        time.sleep(1.5)
        asked = newest(drive, "actuation")
        asked = asked["desired_velocity_mps"], asked["desired_steering_rad"]
        require(asked == (0.5, STEERING_RAD), f"all of both sticks asks for {asked}")
        person.joy(1.0, held=[4], frozen=True)
        drive.wait("late messages stop it", lambda: newest(drive, "truth").get("speed_mps") == 0.0)
        require(drives(drive) == "person", "it was handed back")
        person.joy()
        person.joy(0.6, held=[4])
        drive.wait("it drives on", lambda: newest(drive, "truth").get("speed_mps", 0.0) > 0.2)
        person.joy(0.6, held=[4, 6])
        drive.wait("it is paused", lambda: drives(drive) == "nobody" and newest(drive, "truth").get("blocked") == 1)
        person.joy(0.6, held=[4])
        time.sleep(0.3)
        require(drives(drive) == "nobody", "the stick counts before the button was let go")
        person.joy()
        person.joy(held=[7])
        code = drive.finish(60)
        require(code == 0, f"exit code {code}: {drive.output()}")
        log = (drive.folder / "out/logs/teleop.log").read_text()
        require("ms old, at most 200 ms are allowed" in log, f"late messages are not named: {log}")
        changes = [change["driven_by"] for change in drive.report()["driver_changes"]]
        require(changes == ["person", "nobody", "controller"], f"{changes}")
        return f"{changes}; {drive.report()['drive']['final_distance_m']:.3f} m from the goal"


def button(options):
    """A button of ROS 2 stops the wheels when it is pressed, and when it is silent."""
    with Drive(options, 98, 14.0, NOISE) as drive:
        add(drive, "emergency-stop", 'writes = ["button"]', text=BUTTON)
        robot, report = drive.start_robot()
        person = Person(drive)
        drive.start()
        press = lambda data: person.say("/emergency_stop", "Bool", {"data": data}, rate_hz=20.0)
        reason = lambda: newest(drive, "actuation").get("reason")

        def resume():
            drive.wait("it is released", lambda: reason() != "emergency_stop")
            drive.scanloop("resume")
            drive.wait("it drives", lambda: newest(drive, "actuation").get("kind") == "drive")
            time.sleep(1.0)

        drive.wait("without a button it stands", lambda: reason() == "emergency_stop")
        press(False)
        resume()
        stops = []
        for act in (lambda: press(True), lambda: person.say("/emergency_stop")):
            stops.append(time.monotonic())
            act()
            drive.wait("it stands", lambda: reason() == "emergency_stop")
            time.sleep(0.5)
            stops.append(time.monotonic())
            press(False)
            drive.wait("it is released", lambda: reason() == "paused")
            time.sleep(0.5)
            resume()
        code = drive.finish(60)
        found = seen(robot, report)
        reached(drive, found, code)
        times = []
        for begin, released in (stops[:2], stops[2:]):
            # Nothing drives on until the drive is resumed, half a second after the button was released.
            until = released + 0.4
            part = {"events": [event for event in found["events"] if event[1] <= until]}
            times.append(first_zero_s(part, begin))
        pressed, silent = times
        require(pressed < 2 * PERIOD_S, f"the wheels were stopped {pressed:.3f} s after it was pressed")
        require(0.2 < silent < 0.3 + 3 * PERIOD_S, f"the wheels were stopped {silent:.3f} s after it was silent")
        return f"zero commands {1e3 * pressed:.0f} ms after it was pressed, {1e3 * silent:.0f} ms after the last message"


def goal(options):
    """A goal from RViz becomes that of the drive; one in another frame, or that can't be reached, is refused with its reason."""
    with Drive(options, 99, 5.0) as drive:
        add(drive, "view", VIEW, more=["--control"])
        person = Person(drive)
        start_emulated(drive, "free", "--set", "goal.x_m=20")
        drive.wait("it drives", lambda: newest(drive, "actuation").get("kind") == "drive")
        log = lambda: (drive.folder / "out/logs/view.log").read_text()

        def send(frame, x, y):
            fields = {"header.frame_id": frame, "pose.position.x": x, "pose.position.y": y, "pose.orientation.w": 1.0}
            person.say("/goal_pose", "PoseStamped", fields)

        for frame, x, reason in (("map", 9.0, "its frame is `map`, but `track` is needed"), ("track", -40.0, "goal")):
            send(frame, x, 0.0)
            text = f"the goal x {x:.2f} m, y 0.00 m in `{frame}` from /goal_pose was not taken: "
            drive.wait(f"the goal in {frame} is refused", lambda: text in log())
            told = log().split(text)[1].splitlines()[0]
            require(reason in told, told)
        send("track", 12.0, 0.2)
        drive.wait("it is taken", lambda: "the goal x 12.00 m, y 0.20 m in `track` from /goal_pose is that of the drive" in log())
        code = drive.finish(60)
        require(code == 0, f"exit code {code}: {drive.output()}")
        changes = drive.report()["goal_changes"]
        require([(change["x_m"], change["y_m"]) for change in changes] == [(12.0, 0.2)], f"{changes}")
        return f"{changes}; refused: {told}"
