"""The printed linear filter against filterpy on the same inputs: states and covariances are equal to 1e-9."""

import numpy as np
from filterpy.kalman import KalmanFilter

from drives import wrap

PROCESS = np.diag([0.1, 0.1, 100.0])
MEASUREMENT = np.diag([1.0, 1.0, 10.0])
INTERVAL_S = 0.1
TOLERANCE = 1e-9
KEYS = ["profile=source", "laser=off", "filter=linear", "correction=off"]


def largest_difference(rows, odometry, times_ns):
    """`rows` are innovation, state and covariance of each scan, in terms of yaw, x and y."""
    innovations, states, covariances = rows[:, :3], rows[:, 3:6], rows[:, 6:15].reshape(-1, 3, 3)
    measured = odometry[:, [2, 0, 1]]
    peer = KalmanFilter(dim_x=3, dim_z=3)
    peer.x, peer.P = measured[0].copy(), MEASUREMENT.copy()
    peer.F, peer.H, peer.R, peer.B = np.eye(3), np.eye(3), MEASUREMENT, np.eye(3)
    worst = 0.0
    for index in range(1, len(rows)):
        # B u is the motion of the model: what was expected, less the state before.
        moved = measured[index] - innovations[index] - states[index - 1]
        moved[0] = wrap(moved[0])
        peer.predict(u=moved, Q=PROCESS * (times_ns[index] - times_ns[index - 1]) * 1e-9 / INTERVAL_S)
        seen = measured[index].copy()
        seen[0] = peer.x[0] + wrap(seen[0] - peer.x[0])
        peer.update(seen)
        off = states[index] - peer.x
        off[0] = wrap(off[0])
        worst = max(worst, np.abs(off).max(), np.abs(covariances[index] - peer.P).max())
    return worst
