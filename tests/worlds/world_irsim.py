"""A world in ir-sim: its kinematics move the robot, its lidar measures, and its collision check judges."""

import contextlib
import io
import os
import tempfile

import numpy
import yaml
from surroundings import around

with contextlib.redirect_stdout(io.StringIO()):
    import matplotlib

    matplotlib.use("Agg")
    import irsim

LENGTH_M, WIDTH_M = 0.56, 0.40
FAN_RAD, BEAMS = 4.1852, 682


class World:
    """The robot among bodies, and what stands around them."""

    def __init__(self, world, step_s):
        wheelbase = world.get("wheelbase_m")
        self._wheelbase = wheelbase
        shape = {"name": "rectangle", "length": LENGTH_M, "width": WIDTH_M}
        if wheelbase:
            shape["wheelbase"] = wheelbase
        robot = {
            "kinematics": {"name": "acker" if wheelbase else "diff"},
            "shape": shape,
            "state": [0.0, 0.0, 0.0] + ([0.0] if wheelbase else []),
            "vel_min": [-2.0, -2.0],
            "vel_max": [2.0, 2.0],
            "sensors": [
                {"name": "lidar2d", "range_min": 0.0, "range_max": 6.0, "angle_range": FAN_RAD, "number": BEAMS}
            ],
        }
        length = world["goal"][0] + 8.0
        obstacles = [self._obstacle(body) for body in world["bodies"] + around(world)]
        space = {"height": 20, "width": length + 10, "offset": [-6, -10], "step_time": step_s, "sample_time": step_s}
        space["collision_mode"] = "unobstructed"
        with tempfile.NamedTemporaryFile("w", suffix=".yaml", delete=False) as file:
            yaml.safe_dump({"world": space, "robot": [robot], "obstacle": obstacles}, file)
        self._env = irsim.make(file.name, display=False, log_level="ERROR", seed=1)
        os.unlink(file.name)
        self._robot = self._env.robot
        self.step(0.0, 0.0, True)  # the first one takes long

    @staticmethod
    def _obstacle(body):
        yaw = body.get("yaw", 0.0)
        if "polygon" in body:
            return {"shape": {"name": "polygon", "vertices": body["polygon"]}, "state": [0.0, 0.0, 0.0]}
        if "radius" in body:
            shape = {"name": "circle", "radius": body["radius"]}
        else:
            shape = {"name": "rectangle", "length": body["size"][0], "width": body["size"][1]}
        obstacle = {"shape": shape, "state": [*body["at"], yaw]}
        if "velocity" in body:
            vx, vy = body["velocity"]
            far = [body["at"][0] + 60 * vx, body["at"][1] + 60 * vy, 0.0]
            obstacle |= {"kinematics": {"name": "omni"}, "behavior": {"name": "dash"}, "goal": far}
            obstacle |= {"vel_min": [-abs(vx), -abs(vy)], "vel_max": [abs(vx), abs(vy)]}
        return obstacle

    def step(self, speed_mps, curvature_per_m, _blocked):
        """Moves on by a step; pose and speed of the robot's centre, and whether it touches something."""
        if self._wheelbase:
            turn = numpy.arctan(curvature_per_m * self._wheelbase)
        else:
            turn = curvature_per_m * speed_mps
        self._env.step(numpy.array([[speed_mps], [turn]]))
        x, y, yaw = (float(value) for value in self._robot.state.ravel()[:3])
        if self._wheelbase:  # its state is that of the rear axle
            x, y = x + self._wheelbase / 2 * numpy.cos(yaw), y + self._wheelbase / 2 * numpy.sin(yaw)
        self._ranges = self._robot.get_lidar_scan()
        return (float(x), float(y), yaw, speed_mps), bool(self._robot.collision)

    def ranges(self, angles_rad):
        """Distances along directions from straight ahead [m]."""
        scan = self._ranges
        indices = numpy.rint((numpy.array(angles_rad) - scan["angle_min"]) / scan["angle_increment"]).astype(int)
        return [float(scan["ranges"][index]) for index in numpy.clip(indices, 0, BEAMS - 1)]
