"""What the tools of ROS 2 see of a drive."""

import json
import subprocess
import sys

import yaml

from drive import ROOT, Drive, end, require


VIEW = """
[[process]]
role = "companion"
name = "ros2-view"
command = ["{program}", "view", "domain={domain}", "interface=127.0.0.1"]
reads = ["scan", "odometry", "pose", "obstacles", "command", "actuation"]
"""


# What the tools show, by the kind of a panel or display.
TYPES = {
    "LaserScan": "sensor_msgs/msg/LaserScan",
    "Path": "nav_msgs/msg/Path",
    "MarkerArray": "visualization_msgs/msg/MarkerArray",
}
IN_3D = {*TYPES.values()}
GOAL = "/goal_pose"


def panels(layout):
    """The names of the panels in a layout of Foxglove."""
    return [layout] if isinstance(layout, str) else panels(layout["first"]) + panels(layout["second"])


def pictures(published):
    """Checks the layout of Foxglove and the configuration of rviz2 against the topics that are published, by name."""
    foxglove = json.loads((ROOT / "examples/ros2/foxglove.json").read_text())
    configs = foxglove["configById"]
    require(sorted(panels(foxglove["layout"])) == sorted(configs), f"panels: {panels(foxglove['layout'])}, configured: {list(configs)}")
    shown = 0
    for name, config in configs.items():
        kind = name.split("!")[0]
        if kind == "3D":
            wanted = [(topic, IN_3D) for topic in config["topics"]]
            require(config["publish"]["poseTopic"] == GOAL, f"the goal goes to {config['publish']}")
        elif kind == "Plot":
            wanted = [(path["value"].split(".")[0], {"nav_msgs/msg/Odometry"}) for path in config["paths"]]
        else:
            require(kind == "DiagnosticSummary", f"panel {name}")
            wanted = [(config["topicToRender"], {"diagnostic_msgs/msg/DiagnosticArray"})]
        for topic, types in wanted:
            require(published.get(topic) in types, f"foxglove.json: {name} shows {topic}, which is {published.get(topic)}")
        shown += len(wanted)
    rviz = yaml.safe_load((ROOT / "examples/ros2/scanloop.rviz").read_text())["Visualization Manager"]
    for display in rviz["Displays"]:
        topic, kind = display.get("Topic", {}).get("Value"), TYPES.get(display["Class"].split("/")[1])
        require(published.get(topic) == kind, f"scanloop.rviz: {display['Name']} shows {topic}, which is {published.get(topic)}")
        shown += topic is not None
    goals = [tool["Topic"]["Value"] for tool in rviz["Tools"] if tool["Class"].endswith("SetGoal")]
    require(goals == [GOAL], f"scanloop.rviz: the goal goes to {goals}")
    require(shown >= 11, f"only {shown} topics are shown")
    return f"{shown} topics of rviz2 and Foxglove exist"


def view(options):
    """The companion shows an emulated drive to a listener with rclpy, and says that a goal was not taken."""
    with Drive(options, 87, 5.0) as drive:
        drive.system.write_text(VIEW.format(program=options.ros2, domain=87))
        command = [sys.executable, ROOT / "tests/ros2/listen.py"]
        listener = subprocess.Popen(command, env=drive.environment, stdout=subprocess.PIPE, text=True)
        drive.stack.callback(end, listener)
        require(listener.stdout.readline() == "ready\n", "the listener does not start")
        with open(drive.folder / "err", "w") as errors:
            command = [options.scanloop, "run", "corridor", "--system", drive.system, "--out", "out", "--quiet"]
            drive.run = subprocess.Popen(command, cwd=drive.folder, env=drive.environment, stdout=errors, stderr=errors)
        code = drive.finish(60)
        require(code == 0, f"exit code {code}: {drive.output()}")
        listener.terminate()
        found = json.loads(listener.stdout.readline())
        listener.wait(10)
        published = drive.report()["scans"]["published"]
        least = min(found["counts"].values())
        require(least > published - 25, f"{found['counts']} of {published} scans")
        require(found["rays"] == 682 and found["returns"] > 300, f"{found}")
        require(abs(found["x_m"] - 10.0) < 0.2 and abs(found["path_m"] - 10.0) < 0.2, f"{found}")
        require(0.0 <= found["age_s"] < 30.0, f"{found}")
        states = {name: message for name, message, _ in found["states"]}
        require(len(states) in (5, 6) and states["scanloop: controller"] == "works", f"{found['states']}")
        goal = "the goal x 7.00 m, y -1.00 m in `track` from /goal_pose was not taken"
        require(goal in (found["goal"] or ""), f"of a goal it says: {found['goal']}")
        told = pictures(found["topics"])
        return f"{found['counts']} of {published} scans; {found['states'][3]}; {told}"
