"""Laser odometry of others, in the plane: KISS-ICP and small_gicp, each with the odometer's motion as first guess.

Each is timed from points that are ready to the pose and the map that are ready for the next scan, within the calls of its
own native code, by one thread; what Python does between is not counted.
"""

import math
import time

import numpy as np
import small_gicp
from kiss_icp.pybind import kiss_icp_pybind as kiss

from drives import moved

RANGE_M = 5.6


def matrix(pose):
    x, y, yaw = pose
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.array([[cos, -sin, 0.0, x], [sin, cos, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def planar(transform):
    return np.array([transform[0, 3], transform[1, 3], math.atan2(transform[1, 0], transform[0, 0])])


def vector(points):
    return kiss._Vector3dVector(np.ascontiguousarray(points))


class Kiss:
    """The loop of its class KissICP, with the odometer's motion in place of a constant velocity."""

    # Size of a voxel [m], and the threshold: the first one of those that adapt, or a fixed one [m].
    SETTINGS = [(voxel, threshold, is_fixed) for voxel in (0.1, 0.2, 0.4)
                for threshold, is_fixed in ((0.5, False), (0.1, True))]

    def __init__(self, setting):
        self.voxel, self.threshold, self.is_fixed = setting
        self.map = kiss._VoxelHashMap(voxel_size=self.voxel, max_distance=RANGE_M, max_points_per_voxel=20)
        self.registration = kiss._Registration(max_num_iterations=500, convergence_criterion=1e-4, max_num_threads=1)
        self.adaptive = kiss._AdaptiveThreshold(initial_threshold=self.threshold, min_motion_th=0.01, max_range=RANGE_M)

    def follow(self, points, guess):
        points, start = vector(points), matrix(guess)
        clock = time.perf_counter_ns
        begun = clock()
        frame = kiss._voxel_down_sample(points, self.voxel * 0.5)
        source = kiss._voxel_down_sample(frame, self.voxel * 1.5)
        sigma = self.threshold if self.is_fixed else self.adaptive._compute_threshold()
        pose = self.registration._align_points_to_map(points=source, voxel_map=self.map, initial_guess=start,
                                                      max_correspondance_distance=3 * sigma, kernel=sigma)
        took = clock() - begun
        flat = planar(pose)
        pose = matrix(flat)
        deviation = np.linalg.inv(start) @ pose
        begun = clock()
        self.adaptive._update_model_deviation(model_deviation=deviation)
        self.map._update(frame, pose)
        return flat, took + clock() - begun


class Gicp:
    """A scan is aligned with the last key scan, which a new one replaces after some way or turn, or with the sum of all."""

    # Kind, distance of points after thinning [m], farthest correspondence [m], way to the next key scan [m].
    SETTINGS = [(kind, thin, 0.3, key) for kind in ("GICP", "PLANE_ICP") for thin in (0.02, 0.05) for key in (0.3, 1.0)]
    SETTINGS += [("VGICP", thin, 0.3, 0.25) for thin in (0.02, 0.05)]

    def __init__(self, setting):
        self.kind, self.thin, self.far, self.key = setting
        self.target = None
        if self.kind == "VGICP":
            self.target = small_gicp.GaussianVoxelMap(self.key)
            self.target.set_lru(200, 10)
            self.is_empty = True

    def follow(self, points, guess):
        # In one plane a line has no normal: so the walls are 0.1 m high.
        high = np.vstack([points + [0.0, 0.0, z] for z in (-0.05, 0.0, 0.05)]) if self.kind != "ICP" else points
        cloud = small_gicp.PointCloud(high)
        clock = time.perf_counter_ns
        begun = clock()
        source, tree = small_gicp.preprocess_points(cloud, self.thin, 10, 1)
        took = clock() - begun
        if source.size() < 20:
            return guess, took
        if self.kind == "VGICP":
            return self.voxels(source, guess, took)
        if self.target is None:
            self.target = (source, tree, guess)
            return guess, took
        target, target_tree, at = self.target
        start = np.linalg.inv(matrix(at)) @ matrix(guess)
        begun = clock()
        found = small_gicp.align(target, source, target_tree, start, registration_type=self.kind,
                                 max_correspondence_distance=self.far, num_threads=1, max_iterations=30)
        took += clock() - begun
        pose = planar(matrix(at) @ found.T_target_source)
        way = np.hypot(*(pose[:2] - at[:2]))
        if way > self.key or abs((pose[2] - at[2] + math.pi) % (2 * math.pi) - math.pi) > 0.3:
            self.target = (source, tree, pose)
        return pose, took

    def voxels(self, source, guess, took):
        clock = time.perf_counter_ns
        pose, start = guess, matrix(guess)
        if not self.is_empty:
            begun = clock()
            found = small_gicp.align(self.target, source, start, max_correspondence_distance=self.far, num_threads=1,
                                     max_iterations=30)
            took += clock() - begun
            pose = planar(found.T_target_source)
        self.is_empty = False
        at = matrix(pose)
        begun = clock()
        self.target.insert(source, at)
        return pose, took + clock() - begun


def follow(odometer, drive):
    """Poses of a drive, and times per scan [ns]."""
    pose = drive.odometry[0].copy()
    poses, times = [], []
    for index, points in enumerate(drive.points):
        guess = moved(pose, drive.motions[index - 1]) if index else pose
        pose, took = odometer.follow(points, guess) if len(points) >= 20 else (guess, 0)
        poses.append(pose)
        times.append(took)
    return np.array(poses), np.array(times)
