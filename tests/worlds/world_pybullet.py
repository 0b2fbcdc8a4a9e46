"""A world in pybullet: rigid bodies, and its racecar with tyre contact and motors of limited torque."""

import math

import pybullet as bullet
import pybullet_data
from surroundings import around

LASER_M, WHEELBASE_M, WHEEL_M = 0.12, 0.325, 0.051
TRACK_M = 0.245
REAR, FRONT, STEERED = [(2, 1), (3, -1)], [(5, 1), (7, -1)], (4, 6)  # joints, and on which side a wheel is
# The car turns less than its wheels, measured from 1 to 3 m/s: by this factor, and by this much less per m/s.
UNDERSTEER = 1.02, 0.025
SUBSTEP_S = 0.0025
OUTSIDE_M = 0.3  # of the car


class World:
    """The racecar among bodies, and what stands around them."""

    def __init__(self, world, step_s):
        bullet.connect(bullet.DIRECT)
        bullet.setGravity(0, 0, -9.81)
        bullet.setTimeStep(SUBSTEP_S)
        bullet.setAdditionalSearchPath(pybullet_data.getDataPath())
        self._ground = bullet.loadURDF("plane.urdf")
        # Its links' frames begin at the rear axle; the robot's centre is half a wheelbase ahead.
        self._car = bullet.loadURDF("racecar/racecar.urdf", [-WHEELBASE_M / 2, 0, 0.05])
        for joint in range(bullet.getNumJoints(self._car)):
            bullet.setJointMotorControl2(self._car, joint, bullet.VELOCITY_CONTROL, targetVelocity=0, force=0)
        self._bodies = [(self._body(body), body) for body in world["bodies"] + around(world)]
        for _ in range(200):
            bullet.stepSimulation()
        self._time_s, self._step_s = 0.0, step_s

    @staticmethod
    def _body(body):
        at = body.get("at", [0.0, 0.0])
        if "polygon" in body:
            bottom = [[x, y, 0.0] for x, y in body["polygon"]]
            top = [[x, y, 0.5] for x, y in body["polygon"]]
            shape = bullet.createCollisionShape(bullet.GEOM_MESH, vertices=bottom + top)
        elif "radius" in body:
            shape = bullet.createCollisionShape(bullet.GEOM_CYLINDER, radius=body["radius"], height=0.5)
        else:
            shape = bullet.createCollisionShape(
                bullet.GEOM_BOX, halfExtents=[body["size"][0] / 2, body["size"][1] / 2, 0.25]
            )
        turned = bullet.getQuaternionFromEuler([0, 0, body.get("yaw", 0.0)])
        height = 0.0 if "polygon" in body else 0.25
        return bullet.createMultiBody(0, shape, -1, [*at, height], turned)

    def step(self, speed_mps, curvature_per_m, blocked):
        """Moves on by a step; pose and speed of the robot's centre, and whether it touches something."""
        self._time_s += self._step_s
        for identity, body in self._bodies:
            if "velocity" in body:
                at = [start + self._time_s * v for start, v in zip(body["at"], body["velocity"])]
                bullet.resetBasePositionAndOrientation(identity, [*at, 0.25], [0, 0, 0, 1])
        factor, less = UNDERSTEER
        curvature = curvature_per_m / (factor - less * abs(speed_mps))
        for joint in STEERED:
            target = math.atan(WHEELBASE_M * curvature)
            bullet.setJointMotorControl2(self._car, joint, bullet.POSITION_CONTROL, targetPosition=target, force=10)
        # The rear wheels drive, by a differential; all are braked.
        for joint, side in REAR + FRONT:
            force = 10 if blocked or (joint, side) in REAR else 0
            wheel = 0.0 if blocked else speed_mps * (1 - side * curvature * TRACK_M / 2) / WHEEL_M
            bullet.setJointMotorControl2(
                self._car, joint, bullet.VELOCITY_CONTROL, targetVelocity=wheel, force=force
            )
        for _ in range(round(self._step_s / SUBSTEP_S)):
            bullet.stepSimulation()
        (x, y, _), turned = bullet.getBasePositionAndOrientation(self._car)
        yaw = bullet.getEulerFromQuaternion(turned)[2]
        velocity = bullet.getBaseVelocity(self._car)[0]
        ahead = velocity[0] * math.cos(yaw) + velocity[1] * math.sin(yaw)
        self._at = x + WHEELBASE_M / 2 * math.cos(yaw), y + WHEELBASE_M / 2 * math.sin(yaw), yaw
        touched = any(bullet.getContactPoints(self._car, identity) for identity, _ in self._bodies)
        return (*self._at, ahead), touched

    def ranges(self, angles_rad):
        """Distances along directions from straight ahead [m]."""
        x, y, yaw = self._at
        ends = [(x + 6 * math.cos(yaw + a), y + 6 * math.sin(yaw + a), LASER_M) for a in angles_rad]
        # The rays begin outside of the car, which they would hit.
        begins = [(x + OUTSIDE_M * math.cos(yaw + a), y + OUTSIDE_M * math.sin(yaw + a), LASER_M) for a in angles_rad]
        nothing = (-1, self._car, self._ground)
        hits = bullet.rayTestBatch(begins, ends)
        return [6.0 if hit[0] in nothing else OUTSIDE_M + hit[2] * (6 - OUTSIDE_M) for hit in hits]
