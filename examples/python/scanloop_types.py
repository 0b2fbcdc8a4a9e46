"""The samples of Scanloop. Made by `scanloop types --python`: do not edit, make it again.

Fixed layout, no padding; lengths in metres, angles in radians counter-clockwise, x along the track, y to the left.
"""

import ctypes
import enum

ROLES = 5  # Number of roles
SLOTS = 8  # Largest number of processes in the loop
MAX_BEAMS = 2048  # Largest number of beams of a scan
BEAMS = 682  # Number of beams of the URG-04LX
FRONT_BEAM = 340  # Index of its beam that looks straight ahead
FIRST_ANALYSED_BEAM = 170  # Its first beam analysed for obstacles, 60 deg to the right
LAST_ANALYSED_BEAM = 511  # Its last beam analysed for obstacles, 60 deg to the left
MIN_RANGE_MM = 20  # Ranges below this are error codes: no return [mm]
PITCH_RAD = 0.006135923151542565  # Angle between two of its beams [rad]
FIRST_BEAM_YAW_RAD = -2.086213871524472  # Angle of its beam 0, counter-clockwise from straight ahead [rad]
SECTOR_BEAMS = 11  # Beams of one sector of evidence
MAX_OBSTACLES = 16  # How many ellipses a description can hold
PLAN_NODES = 25  # How many nodes of the plan a command carries
CHECKPOINT_BYTES = 12800  # How many bytes of state a checkpoint can hold
JOURNAL_ENTRIES = 20  # How many entries a journal can hold
DEVICE_REASON_BYTES = 96  # How many bytes the reason of a device can have


class Role(enum.IntEnum):
    """The job of one process of the loop."""

    ROBOT = 0  # Moves and measures: the emulated SUMMIT with its scanner, or a driver of a real robot.
    ESTIMATOR = 1  # Corrects measured data and estimates the pose.
    OBSTACLES = 2  # Describes obstacles as ellipses.
    CONTROLLER = 3  # Plans and commands velocity and steering.
    ACTUATOR = 4  # Corrects and limits commands, and blocks the wheels when it must.


class Phase(enum.IntEnum):
    """What the whole system is doing."""

    STARTING = 0  # Processes are starting and open their ports.
    CONNECTING = 1  # All ports exist: each process makes its ends of the connections.
    DRIVING = 2  # The loop runs.
    STOPPING = 3  # Wheels are blocked and processes end.


class ProcessState(enum.IntEnum):
    """The state that a process reports."""

    ATTACHED = 0  # It has opened its ports.
    CONNECTED = 1  # Its connections are made, samples will arrive.
    READY = 2  # It has published its first output.
    ENDING = 3  # It is about to end.


class DeviceState(enum.IntEnum):
    """What the devices behind a process do."""

    NONE = 0  # The process has none, or does not report them.
    CONNECTING = 1  # One of them is being connected or started.
    RUNNING = 2  # All of them deliver data.
    FAULT = 3  # One of them can't be used, or has stopped delivering data.


class Suspect(enum.IntEnum):
    """What the estimator suspects to be calibrated wrongly."""

    NONE = 0  # Nothing.
    VELOCITY_FACTOR = 1  # The velocity factor kv: the speed at the wheels is not the desired one.
    STEERING = 2  # The steering map: the robot turns otherwise than commanded.
    ODOMETRY_LONGITUDINAL = 3  # Odometry scale error, df: fraction of the travelled distance that is not reported.
    ODOMETRY_LATERAL_RATE = 4  # The lateral drift of the odometry, dds.
    HEADING = 5  # The reported heading jumped.
    POSITION = 6  # The reported position jumped.
    VEHICLE = 7  # The vehicle description: the model makes a motion of it that no robot can have.


class ScannerState(enum.IntEnum):
    """What the ranges of the scanner can be used for."""

    HEALTHY = 0  # Returns come where earlier scans predict them.
    DEGRADED = 1  # Many returns are missing or wrong: drive slowly.
    BLIND = 2  # Too few returns come to see an obstacle in time: block the wheels.
    STUCK = 3  # The same ranges are repeated while the robot moves: block the wheels.
    CONTRADICTORY = 4  # The ranges contradict the motion of the robot: block the wheels.


class Alarm(enum.IntEnum):
    """What the estimator asks for because of its suspicion."""

    NONE = 0  # Nothing.
    SLOW = 1  # Drive slowly.
    STOP = 2  # Block the wheels.


class CommandKind(enum.IntEnum):
    """What the command asks for."""

    STOP = 0  # Block the wheels for safety.
    DRIVE = 1  # Drive with the velocity and steering angle of the command.
    LAND = 2  # Block the wheels because the goal is reached.


class Level(enum.IntEnum):
    """Where a command comes from: the rung of the ladder that was reached."""

    STOP = 0  # Wheels blocked.
    CONVERGED = 1  # The converged and verified solution for this scan.
    BEST_ITERATE = 2  # The best verified iterate for this scan.
    LAST_PLAN = 3  # The rest of the last verified plan, verified again against the obstacles of this scan.
    PERSON = 4  # What a person asks for, verified.


class SolveStatus(enum.IntEnum):
    """How the optimal control problem was solved."""

    NOT_SOLVED = 0  # No problem was solved for this command.
    CONVERGED = 1  # The KKT residual is within its tolerance.
    MAX_ITERATIONS = 2  # The iteration limit came first; the best iterate is in the command.
    OUT_OF_TIME = 3  # The time budget came first; the best iterate is in the command.
    FAILED = 4  # No step could be computed.


class StopReason(enum.IntEnum):
    """Why the controller asks to block the wheels."""

    NONE = 0  # It does not.
    LANDED = 1  # The goal is reached.
    BLOCKED = 2  # The path is blocked, or too near to steer around.
    UNVERIFIED = 3  # No plan of this scan or the last could be verified.
    BAD_INPUT = 4  # The inputs contradict each other or the bounds.
    GOAL_PASSED = 5  # The goal was passed and cannot be reached any more.
    NO_INPUT = 6  # No input came in time.
    SELF_CHECK = 7  # The estimator suspects a wrong calibration.
    STATE_LOST = 8  # The state of the process before was lost while the robot drove: it comes to rest first.
    NO_SAFE_SPEED = 9  # At no speed can the robot stop in time: scans are too rare or the data too old.
    SCANNER = 10  # The scanner is blind, stuck or contradictory: obstacles would not be seen.
    COVERED_BY_OBSTACLE = 11  # A described obstacle covers the robot: the obstacle detector is wrong.
    PAUSED = 12  # A person has paused the drive.
    RELEASED = 13  # The person who drives asks for no motion, or is silent.
    REVERSAL = 14  # The robot stands to change between forwards and backwards.
    UNSEEN = 15  # Backwards, every plan leads to ground that the scanner has not shown.


class DrivenBy(enum.IntEnum):
    """Who drives the robot."""

    CONTROLLER = 0  # The controller, to its goal.
    NOBODY = 1  # The drive is paused: wheels are blocked, and all processes stay ready.
    PERSON = 2  # A person, by what `GivenControl` says.


class ActuationKind(enum.IntEnum):
    """What the robot is told."""

    BLOCK = 0  # Block the wheels.
    DRIVE = 1  # Turn the wheels with the velocity and angle sent.


class BlockReason(enum.IntEnum):
    """Why the actuator blocks the wheels."""

    NONE = 0  # It does not.
    LANDED = 1  # The goal is reached.
    COMMANDED = 2  # The controller asked for a stop.
    NO_COMMAND = 3  # No valid command came within 1.5 scan periods.
    INVALID_COMMAND = 4  # The command was not finite, not verified, or outside its hard limits.
    STALE_COMMAND = 5  # The scan behind the command is too old.
    STOP_REQUESTED = 6  # The user or the orchestrator asked for a stop.
    START = 7  # Nothing has been commanded yet.
    PAUSED = 8  # A person has paused the drive.
    RELEASED = 9  # The person who drives is silent.
    EMERGENCY_STOP = 10  # An emergency stop from outside is pressed, or silent.


class Rule(enum.IntEnum):
    """The rule that a dropped or refused sample failed."""

    NONE = 0  # It failed none.
    FOREIGN_LAYOUT = 1  # Its layout is that of this system.
    NOT_FINITE = 2  # Its numbers are finite.
    OUT_OF_RANGE = 3  # Its numbers are within the ranges of the fields.
    UNKNOWN_VALUE = 4  # Its enumerations hold known numbers.
    NOT_VERIFIED = 5  # A command to drive was verified.
    OUTSIDE_BOUNDS = 6  # A command to drive is within the hard limits of the actuator.
    TOO_OLD = 7  # Its scan is young enough.
    FROM_THE_FUTURE = 8  # Its scan does not lie in the future.
    ANSWERED_BEFORE = 9  # Its scan was not answered before.
    IMPOSSIBLE_NUMBER = 10  # Its numbers are such as its scan and its publisher can have reached.
    STILL_ROLLING = 11  # A command to drive the other way finds the robot at rest.


class JournalKind(enum.IntEnum):
    """What an entry of a journal states."""

    NONE = 0  # Nothing.
    TAKEN = 1  # The process took a sample: `topic`, `incarnation`, and its sequence number in `value`.
    USED = 2  # What was taken last is used; `value` is the time that the stage is told [ns].
    TIMER = 3  # A timeout did something, at the time `value` [ns].
    BUDGET = 4  # The time budget ended a solution, which had read the clock `value` times before.
    STOPPED = 5  # The wheels are blocked for a stop, at the time `value` [ns].
    RELEASED = 6  # A stop has ended.
    DROPPED = 7  # Commands were dropped before the process saw them.
    HELD_BACK = 8  # The output that follows would have driven: the port made it a block.
    BEGUN = 9  # The process begins, at the time `value` [ns].
    BEGUN_IN_STOP = 10  # The process begins in stop, because the state of the one before it is lost.
    RESUMED = 11  # The process continues from a checkpoint: `incarnation` has published it, with the sequence number `value`.
    SAVED = 12  # The process has published its checkpoint with the sequence number `value`.
    INJECTED = 13  # An injected fault has changed a sample behind the process: `topic`, `incarnation`, and its sequence number in `value`.
    ALTERED = 14  # An injected fault alters the emulated robot from now on (`value` 1), or no longer (0).
    MOVED = 15  # The sample or state of the next entry was handed over with its times moved by `value` [ns], in two's complement.
    EMERGENCY_STOP = 16  # The wheels are blocked for an emergency stop, at the time `value` [ns].
    OWN = 17  # A sample of a topic of your own was read, of the scan `value`; its fields follow.
    NUMBER = 18  # The next field of that sample: the bits of an f64 in `value`.


class StageStamps(ctypes.Structure):
    """A part of samples."""

    _fields_ = [
        ("woken_ns", ctypes.c_uint64),  # When the stage was woken for the scan [ns]
        ("taken_ns", ctypes.c_uint64),  # When all of its inputs were taken [ns]
        ("computed_ns", ctypes.c_uint64),  # When its computation was done [ns]
        ("published_ns", ctypes.c_uint64),  # When its output was published [ns]
    ]


class Header(ctypes.Structure):
    """A part of samples."""

    _fields_ = [
        ("layout", ctypes.c_uint32),  # Layout version of the sample, `Sample::LAYOUT`
        ("incarnation", ctypes.c_uint32),  # Incarnation of the producer: one number per started process, given by the orchestrator
        ("scan_id", ctypes.c_uint64),  # The scan that this sample belongs to; the first scan of a run is 1
        ("sequence", ctypes.c_uint64),  # Number of the sample among those of its producer on its topic, from 1 without gaps
        ("acquired_ns", ctypes.c_uint64),  # When the front beam of the scan was taken [ns]
        ("chain", StageStamps * 8),  # Stamps of all stages on the way to this sample, by slot: the five roles come first
    ]


class ScannerHealth(ctypes.Structure):
    """A part of samples."""

    _fields_ = [
        ("state", ctypes.c_uint32),  # Whether and how fast the robot may drive with these ranges, `ScannerState`
        ("identical_scans", ctypes.c_uint32),  # Scans in a row with the ranges of the scan before, while the robot moved
        ("unseen_sectors", ctypes.c_uint64),  # Sectors without evidence, one bit each: sector k has the beams 11 k to 11 k + 10
        ("valid_share", ctypes.c_double),  # Share of the window's beams with a valid range
        ("returned_share", ctypes.c_double),  # Share of the returns that came where earlier scans predict them; 1 where none are predicted
        ("blind_s", ctypes.c_double),  # Time since the last scan with ranges; zero when this one has them [s]
        ("seen_ahead_m", ctypes.c_double),  # Farthest distance ahead, from the robot's centre, at which nothing that appears can be missed [m]
        ("range_factor", ctypes.c_double),  # Estimated ratio of the reported ranges to the true ones
        ("range_offset_m", ctypes.c_double),  # Estimated length added to the reported ranges [m]
        ("yaw_error_rad", ctypes.c_double),  # Estimated error of the mounting angle, counter-clockwise [rad]
    ]


class Obstacle(ctypes.Structure):
    """A part of samples."""

    _fields_ = [
        ("id", ctypes.c_uint32),  # Identity of the ellipse, kept while it is tracked; never 0
        ("body", ctypes.c_uint32),  # Identity of the body that the ellipse belongs to
        ("x_m", ctypes.c_double),  # Centre of the ellipse along the track, (7.32) [m]
        ("y_m", ctypes.c_double),  # Centre of the ellipse across the track, (7.33) [m]
        ("a_m", ctypes.c_double),  # Semi-axis along the track, a of (7.34) [m]
        ("b_m", ctypes.c_double),  # Semi-axis across the track, b of (7.35) [m]
        ("velocity_x_mps", ctypes.c_double),  # Velocity along the track [m/s]
        ("velocity_y_mps", ctypes.c_double),  # Velocity across the track [m/s]
        ("velocity_covariance", ctypes.c_double * 3),  # Covariance of the velocity: xx, xy, yy [m^2/s^2]
        ("box_x_m", ctypes.c_double),  # Centre of the body's box along the track [m]
        ("box_y_m", ctypes.c_double),  # Centre of the body's box across the track [m]
        ("box_length_m", ctypes.c_double),  # Full length of the body's box along its own axis [m]
        ("box_width_m", ctypes.c_double),  # Full width of the body's box [m]
        ("box_yaw_rad", ctypes.c_double),  # Direction of the box's length axis [rad]
        ("unseen_s", ctypes.c_double),  # Time since the body was last seen; zero when this scan shows it [s]
        ("sightings", ctypes.c_uint64),  # Scans that showed the body since it was first seen
    ]


class Margin(ctypes.Structure):
    """A part of samples."""

    _fields_ = [
        ("base_m", ctypes.c_double),  # Distance kept in any case [m]
        ("pose_m", ctypes.c_double),  # Uncertainty of the pose relative to the obstacles, along the plan [m]
        ("latency_m", ctypes.c_double),  # Speed times the age of the data when the command acts [m]
        ("model_m", ctypes.c_double),  # Difference between the robot and its description [m]
        ("perception_m", ctypes.c_double),  # Uncertainty of the described obstacles [m]
    ]


class Blocking(ctypes.Structure):
    """A part of samples."""

    _fields_ = [
        ("x_m", ctypes.c_double),  # Position of its centre along the track [m]
        ("y_m", ctypes.c_double),  # Lateral position of its centre [m]
        ("gap_m", ctypes.c_double),  # The widest gap past it that the robot's body could use, negative when there is none [m]
        ("needed_m", ctypes.c_double),  # The gap that the robot needs there: its body and the margin on both sides [m]
        ("id", ctypes.c_uint32),  # Identity of the ellipse, 0 when no obstacle is the reason
        ("reserved", ctypes.c_uint32),  # Unused, zero
    ]


class Sides(ctypes.Structure):
    """A part of samples."""

    _fields_ = [
        ("left_objective", ctypes.c_double),  # Objective of the plan that passes the obstacle on its left, negative without such a plan
        ("right_objective", ctypes.c_double),  # The same on its right
        ("id", ctypes.c_uint32),  # Identity of the ellipse, 0 when no sides were compared
        ("reserved", ctypes.c_uint32),  # Unused, zero
    ]


class PlanNode(ctypes.Structure):
    """A part of samples."""

    _fields_ = [
        ("x_m", ctypes.c_double),  # Position along the track [m]
        ("y_m", ctypes.c_double),  # Lateral position [m]
        ("yaw_rad", ctypes.c_double),  # Yaw [rad]
        ("sideslip_rad", ctypes.c_double),  # Sideslip [rad]
        ("yaw_rate_radps", ctypes.c_double),  # Yaw rate [rad/s]
        ("velocity_mps", ctypes.c_double),  # Velocity from this node to the next [m/s]
        ("steering_rad", ctypes.c_double),  # Steering angle from this node to the next [rad]
    ]


class Span(ctypes.Structure):
    """A part of samples."""

    _fields_ = [
        ("incarnation", ctypes.c_uint32),  # Incarnation of the writer; 0 for an entry that is not used
        ("reserved", ctypes.c_uint32),  # Unused, zero
        ("first", ctypes.c_uint64),  # First sequence number
        ("last", ctypes.c_uint64),  # Last sequence number
    ]


class InputAccount(ctypes.Structure):
    """A part of samples."""

    _fields_ = [
        ("writers", Span * 4),  # Sequence numbers that arrived, per writer
        ("hole", Span),  # The newest sequence numbers that did not arrive
        ("twice", Span),  # The newest sequence number that arrived twice
        ("late", Span),  # The newest sequence number that arrived after a later one
        ("arrived", ctypes.c_uint64),  # Samples that arrived, repeated ones included
        ("used", ctypes.c_uint64),  # Used
        ("replaced", ctypes.c_uint64),  # Replaced in the process by newer ones before they were used
        ("overwritten", ctypes.c_uint64),  # Overwritten by newer ones in the buffer before they were taken from the bus
        ("stale", ctypes.c_uint64),  # Dropped because they were too old
        ("foreign", ctypes.c_uint64),  # Dropped because their writer had no authority for their scan
        ("invalid", ctypes.c_uint64),  # Dropped because of their content
        ("duplicate", ctypes.c_uint64),  # Dropped because their number had arrived before
        ("reordered", ctypes.c_uint64),  # Dropped because a later number had arrived before
        ("missing", ctypes.c_uint64),  # Sequence numbers that never arrived although the buffer was not full
        ("open", ctypes.c_uint64),  # Samples whose fate is not known yet
        ("open_sum", ctypes.c_uint64),  # Sum of their sequence numbers
        ("waiting", ctypes.c_uint64),  # Samples that wait in the process; equal to `open` if no sample has disappeared
        ("waiting_sum", ctypes.c_uint64),  # Sum of the sequence numbers of samples that wait
        ("unreadable", ctypes.c_uint64),  # Samples of another layout, whose sequence numbers cannot be read
    ]


class Refusal(ctypes.Structure):
    """A part of samples."""

    _fields_ = [
        ("count", ctypes.c_uint64),  # Samples dropped or refused because of their content, since the process started
        ("scan_id", ctypes.c_uint64),  # Scan of the newest one
        ("value", ctypes.c_double),  # Faulty value in the newest one; 0 if it is not finite
        ("incarnation", ctypes.c_uint32),  # Incarnation of the writer of the newest one
        ("rule", ctypes.c_uint32),  # Rule that the newest one violates, `Rule`
        ("field", ctypes.c_uint8 * 32),  # Name of its faulty field in ASCII, padded with zeros
    ]


class Device(ctypes.Structure):
    """A part of samples."""

    _fields_ = [
        ("state", ctypes.c_uint32),  # What they do, `DeviceState`
        ("reserved", ctypes.c_uint32),  # Unused, zero
        ("since_ns", ctypes.c_uint64),  # Since when they do it; 0 while it is not known [ns of CLOCK_MONOTONIC]
        ("reason", ctypes.c_uint8 * 96),  # Why, in a few words of UTF-8, padded with zeros
    ]


class Authority(ctypes.Structure):
    """A part of samples."""

    _fields_ = [
        ("incarnation", ctypes.c_uint32),  # The incarnation whose samples count from `from_scan` on; 0 accepts none
        ("previous", ctypes.c_uint32),  # The incarnation whose samples count before `from_scan`
        ("from_scan", ctypes.c_uint64),  # The scan at which authority changes
    ]


class GivenGoal(ctypes.Structure):
    """A part of samples."""

    _fields_ = [
        ("from_scan", ctypes.c_uint64),  # The first scan for which it counts; later goals count from later scans
        ("index", ctypes.c_uint32),  # Which goal of the drive it replaces, from 0
        ("has_yaw", ctypes.c_uint32),  # 1 when the robot has to stand there in the direction `yaw_rad`
        ("x_m", ctypes.c_double),  # Position along the course; on a line that of the track [m]
        ("y_m", ctypes.c_double),  # Position to the left of the course [m]
        ("tolerance_m", ctypes.c_double),  # Distance within which it is reached [m]
        ("yaw_rad", ctypes.c_double),  # Direction of the robot there, in the plane [rad]
        ("yaw_tolerance_rad", ctypes.c_double),  # Largest difference from that direction [rad]
        ("stay_s", ctypes.c_double),  # How long the robot stands there before it drives to the next goal [s]
    ]


class GivenControl(ctypes.Structure):
    """A part of samples."""

    _fields_ = [
        ("number", ctypes.c_uint64),  # Ascends with each that is given
        ("given_ns", ctypes.c_uint64),  # When it was given [ns of the loop's clock]
        ("velocity_mps", ctypes.c_double),  # Velocity; below the smallest one of the robot it is to stand [m/s]
        ("steering_rad", ctypes.c_double),  # Steering angle [rad]
    ]


class JournalEntry(ctypes.Structure):
    """A part of samples."""

    _fields_ = [
        ("kind", ctypes.c_uint16),  # What it states, `JournalKind`
        ("topic", ctypes.c_uint16),  # Topic of the sample, by its place in the table of topics
        ("incarnation", ctypes.c_uint32),  # Incarnation that has published the sample
        ("value", ctypes.c_uint64),  # A sequence number, a time [ns] or a count
    ]


class Scan(ctypes.Structure):
    """Topic scan, published once per scan, at the end of the sweep."""

    TOPIC = "scan"
    LAYOUT = 0x277a4128
    _fields_ = [
        ("header", Header),  # Identity and stamps; acquired is the time of the front beam
        ("sweep_ns", ctypes.c_uint64),  # How long the sweep over all beams lasts, two thirds of the scan period [ns]
        ("period_ns", ctypes.c_uint64),  # Time between the end of one scan and the end of the next [ns]
        ("first_rad", ctypes.c_double),  # Angle of beam 0 from straight ahead, counter-clockwise [rad]
        ("increment_rad", ctypes.c_double),  # Angle from one beam to the next; negative where the sweep is clockwise [rad]
        ("beams", ctypes.c_uint32),  # How many beams there are: as many of `ranges_mm` count
        ("missing", ctypes.c_uint32),  # 1 when the scanner gave no ranges for this scan: all of them are zero
        ("ranges_mm", ctypes.c_uint32 * 2048),  # Range per beam in the order of the sweep; below 20 is an error code: no return [mm]
    ]

    @staticmethod
    def type_name() -> str:
        return "scanloop.Scan.v3"


class Odometry(ctypes.Structure):
    """Topic odometry, published once per scan, at the end of the sweep."""

    TOPIC = "odometry"
    LAYOUT = 0xd12d7830
    _fields_ = [
        ("header", Header),  # Identity and stamps; same scan id as the scan published with it
        ("x_m", ctypes.c_double),  # Reported position along the track [m]
        ("y_m", ctypes.c_double),  # Reported lateral position, left positive [m]
        ("yaw_rad", ctypes.c_double),  # Reported yaw, in (-pi, pi] [rad]
        ("dx_m", ctypes.c_double),  # Reported x minus the x reported before; zero in the first sample [m]
        ("dy_m", ctypes.c_double),  # Reported y minus the y reported before; zero in the first sample [m]
        ("dyaw_rad", ctypes.c_double),  # Reported yaw minus the yaw reported before; zero in the first sample [rad]
        ("dt_s", ctypes.c_double),  # Time since the sample before; zero in the first sample [s]
        ("speed_mps", ctypes.c_double),  # Speed over ground measured at the wheels, negative backwards [m/s]
    ]

    @staticmethod
    def type_name() -> str:
        return "scanloop.Odometry.v2"


class Pose(ctypes.Structure):
    """Topic pose, published once per odometry sample."""

    TOPIC = "pose"
    LAYOUT = 0xe5773226
    _fields_ = [
        ("header", Header),  # Identity and stamps
        ("yaw_rad", ctypes.c_double),  # Estimated yaw at the acquisition of the scan, x2 of (7.28) [rad]
        ("x_m", ctypes.c_double),  # Estimated position along the track at the acquisition of the scan, x4 of (7.30) [m]
        ("y_m", ctypes.c_double),  # Estimated lateral position at the acquisition of the scan, x5 of (7.31) [m]
        ("covariance", ctypes.c_double * 9),  # Covariance of (yaw, x, y) on the track, row by row [rad^2, rad m, m^2]
        ("local_covariance", ctypes.c_double * 9),  # Covariance of (yaw, x, y) relative to what the scanner sees now, row by row: without the drift of the odometry
        ("speed_mps", ctypes.c_double),  # Speed over ground at the acquisition of the scan, negative backwards [m/s]
        ("sideslip_rad", ctypes.c_double),  # Sideslip at the acquisition of the scan, x1 of (7.27) [rad]
        ("yaw_rate_radps", ctypes.c_double),  # Yaw rate at the acquisition of the scan, x3 of (7.29) [rad/s]
        ("predicted_ns", ctypes.c_uint64),  # When the command for this scan is expected to act: the time of the predicted state [ns]
        ("predicted_sideslip_rad", ctypes.c_double),  # Predicted sideslip [rad]
        ("predicted_yaw_rad", ctypes.c_double),  # Predicted yaw [rad]
        ("predicted_yaw_rate_radps", ctypes.c_double),  # Predicted yaw rate [rad/s]
        ("predicted_x_m", ctypes.c_double),  # Predicted position along the track [m]
        ("predicted_y_m", ctypes.c_double),  # Predicted lateral position [m]
        ("predicted_speed_mps", ctypes.c_double),  # Predicted speed, negative backwards [m/s]
        ("innovation", ctypes.c_double * 3),  # Measured minus predicted (yaw, x, y) of the measurement update [rad, m, m]
        ("gain", ctypes.c_double * 9),  # Kalman gain of (yaw, x, y), row by row
        ("nis", ctypes.c_double),  # Normalised innovation squared
        ("rejected", ctypes.c_uint64),  # Measurements refused by the gate since the start
        ("learned", ctypes.c_double * 6),  # What the estimator has learned of the robot: turn rate [rad/s], shares of the distance and of the turn that the
        ("learned_deviation", ctypes.c_double * 6),  # Their standard deviations; 0 for what is not learned
        ("suspect", ctypes.c_uint32),  # Part of the calibration that is suspected to be wrong, `Suspect`
        ("alarm", ctypes.c_uint32),  # Reaction that the estimator asks for because of it, `Alarm`
    ]

    @staticmethod
    def type_name() -> str:
        return "scanloop.Pose.v4"


class Obstacles(ctypes.Structure):
    """Topic obstacles, published once per scan, when scan and pose are there."""

    TOPIC = "obstacles"
    LAYOUT = 0x6cf0390d
    _fields_ = [
        ("header", Header),  # Identity and stamps
        ("count", ctypes.c_uint32),  # How many of `items` are used
        ("overflow", ctypes.c_uint32),  # Number of ellipses for which `items` had no room
        ("scanner", ScannerHealth),  # What the scanner can be relied on for
        ("items", Obstacle * 16),  # The ellipses, nearest ahead first; unused ones are zero
    ]

    @staticmethod
    def type_name() -> str:
        return "scanloop.Obstacles.v3"


class Command(ctypes.Structure):
    """Topic command, published once per scan, when pose and obstacles are there."""

    TOPIC = "command"
    LAYOUT = 0xdf01b5da
    _fields_ = [
        ("header", Header),  # Identity and stamps
        ("kind", ctypes.c_uint32),  # What the controller asks for, `CommandKind`
        ("level", ctypes.c_uint32),  # Where the command comes from, `Level`
        ("status", ctypes.c_uint32),  # How the problem was solved, `SolveStatus`
        ("reason", ctypes.c_uint32),  # Why the wheels are to be blocked, `StopReason`
        ("verified", ctypes.c_uint32),  # 1 when the plan was verified: bounds, obstacles and model
        ("side", ctypes.c_int32),  # Side on which the nearest obstacle in the way is passed: 1 left, -1 right, 0 none
        ("iterations", ctypes.c_uint32),  # SQP iterations
        ("active_constraints", ctypes.c_uint32),  # Active constraints at the solution
        ("velocity_mps", ctypes.c_double),  # Desired velocity, u1 of (7.27)-(7.31), negative backwards [m/s]
        ("steering_rad", ctypes.c_double),  # Desired steering angle, u2 of (7.27)-(7.31) [rad]
        ("kkt_residual", ctypes.c_double),  # Infinity norm of the KKT conditions
        ("largest_violation", ctypes.c_double),  # Largest violation of a hard constraint or of the model
        ("slack", ctypes.c_double),  # Largest slack of an ellipse
        ("objective", ctypes.c_double),  # Value of the objective
        ("solve_ns", ctypes.c_uint64),  # Time the solver used, zero in lock-step [ns]
        ("plan_start_ns", ctypes.c_uint64),  # Time of the first node of the plan [ns]
        ("plan_interval_s", ctypes.c_double),  # Time between two nodes of the plan [s]
        ("speed_limit_mps", ctypes.c_double),  # Largest velocity at which the robot can still stop in time [m/s]
        ("margin", Margin),  # The clearance that the plan keeps
        ("blocking", Blocking),  # The obstacle that a stop is for, or for which a person drives slower than it asks
        ("sides", Sides),  # What passing an obstacle on each side would cost
        ("plan_length", ctypes.c_uint32),  # How many of `plan` are used
        ("reserved", ctypes.c_uint32),  # Unused, zero
        ("plan", PlanNode * 25),  # The planned nodes
    ]

    @staticmethod
    def type_name() -> str:
        return "scanloop.Command.v4"


class Actuation(ctypes.Structure):
    """Topic actuation, published once per command, and when the actuator blocks the wheels by itself."""

    TOPIC = "actuation"
    LAYOUT = 0xcabc5b8a
    _fields_ = [
        ("header", Header),  # Identity and stamps of the command answered
        ("kind", ctypes.c_uint32),  # What the robot is asked to do, `ActuationKind`
        ("reason", ctypes.c_uint32),  # Why the wheels are blocked, `BlockReason`
        ("stop_reason", ctypes.c_uint32),  # `StopReason` of the command that this answers
        ("answers", ctypes.c_uint32),  # 1 when this answers a command of the scan in the header, 0 when the actuator acts by itself
        ("desired_velocity_mps", ctypes.c_double),  # Desired velocity after limits (7.41), negative backwards [m/s]
        ("desired_steering_rad", ctypes.c_double),  # Desired steering angle after limits (7.41) [rad]
        ("sent_velocity_mps", ctypes.c_double),  # Velocity sent to the robot, after the correction, negative backwards [m/s]
        ("sent_steering_rad", ctypes.c_double),  # Steering angle sent to the robot, after the correction [rad]
        ("refused", ctypes.c_uint64),  # Commands refused since the start: not finite, not verified, stale, out of limits
        ("gaps", ctypes.c_uint64),  # Gaps between scans since the start: the wheels were blocked, and the next valid command ended the block
        ("driven_by", ctypes.c_uint32),  # Who drives, `DrivenBy`
        ("reserved", ctypes.c_uint32),  # Unused, zero
    ]

    @staticmethod
    def type_name() -> str:
        return "scanloop.Actuation.v4"


class Heartbeat(ctypes.Structure):
    """Topic heartbeat, published ten times a second by each process, and at each change of its state."""

    TOPIC = "heartbeat"
    LAYOUT = 0x6a10b069
    _fields_ = [
        ("header", Header),  # Identity; scan id is the last one worked on, the chain is unused
        ("role", ctypes.c_uint32),  # Slot of the process; the first five are those of a `Role`
        ("state", ctypes.c_uint32),  # State that the process reports, `ProcessState`
        ("pid", ctypes.c_uint64),  # Process id
        ("obeys_stop", ctypes.c_uint32),  # 1 when it sees the stop word of its run, and so obeys `scanloop stop` by itself
        ("reserved", ctypes.c_uint32),  # Unused, zero
        ("issued_ns", ctypes.c_uint64),  # When it was published [ns of CLOCK_MONOTONIC]
        ("activations", ctypes.c_uint64),  # Passes through the loop of the process; they stop when it hangs
        ("published", ctypes.c_uint64),  # Outputs published on the first topic of the role
        ("used", ctypes.c_uint64),  # Inputs used
        ("replaced", ctypes.c_uint64),  # Inputs replaced by newer ones before they were used
        ("invalid", ctypes.c_uint64),  # Inputs dropped because of their content
        ("stale", ctypes.c_uint64),  # Inputs dropped because they were too old
        ("duplicate", ctypes.c_uint64),  # Inputs dropped because their sequence number had been seen
        ("reordered", ctypes.c_uint64),  # Inputs dropped because a later one had been seen
        ("foreign", ctypes.c_uint64),  # Inputs dropped because their producer has no authority
        ("missing", ctypes.c_uint64),  # Sequence numbers that never arrived
        ("undelivered", ctypes.c_uint64),  # Outputs that did not reach all of their readers
        ("timeouts", ctypes.c_uint64),  # Wake-ups by timeout
        ("looked_ns", ctypes.c_uint64),  # When samples were last taken from the bus [ns of CLOCK_MONOTONIC]
        ("taken", ctypes.c_uint64),  # Samples taken of the topic that the role answers
        ("taken_scans", ctypes.c_uint64),  # Sum of their scan ids
        ("answered", ctypes.c_uint64),  # Answers to them
        ("answered_scans", ctypes.c_uint64),  # Sum of the scan ids of the answers
        ("written", ctypes.c_uint64 * 4),  # Sequence number of the newest sample per topic that the process writes, in the order of its writes
        ("inputs", InputAccount * 4),  # What became of the samples per topic that the process reads, in the order of its reads
        ("refused", Refusal * 4),  # Samples dropped or refused because of their content, per topic that the process reads
        ("device", Device),  # What the devices behind the process do
    ]

    @staticmethod
    def type_name() -> str:
        return "scanloop.Heartbeat.v5"


class Directive(ctypes.Structure):
    """Topic directive, published ten times a second by the orchestrator, and at each change."""

    TOPIC = "directive"
    LAYOUT = 0xaed04d98
    _fields_ = [
        ("header", Header),  # Identity; the chain is unused
        ("phase", ctypes.c_uint32),  # What the system is doing, `Phase`
        ("stop", ctypes.c_uint32),  # 1 when the wheels are to be blocked now, whatever the controller commands
        ("granted_scan", ctypes.c_uint64),  # In lock-step: the last scan that the robot may publish
        ("issued_ns", ctypes.c_uint64),  # When it was published [ns of CLOCK_MONOTONIC]
        ("orchestrator_pid", ctypes.c_uint64),  # Process id of the orchestrator
        ("authority", Authority * 8),  # Whose samples count, by slot
        ("goal", GivenGoal),  # The goal that was given last while the system drives
        ("driven_by", ctypes.c_uint32),  # Who drives, `DrivenBy`
        ("reserved", ctypes.c_uint32),  # Unused, zero
        ("person", GivenControl),  # What a person who drives asks for
    ]

    @staticmethod
    def type_name() -> str:
        return "scanloop.Directive.v4"


class Checkpoint(ctypes.Structure):
    """Topic checkpoint, published once per scan by each stateful process."""

    TOPIC = "checkpoint"
    LAYOUT = 0x8789a79e
    _fields_ = [
        ("header", Header),  # Identity: the scan after which the state was taken
        ("role", ctypes.c_uint32),  # Slot of the process; the first five are those of a `Role`
        ("state_layout", ctypes.c_uint32),  # Fingerprint of the type of the state
        ("length", ctypes.c_uint32),  # How many of `bytes` are used
        ("reserved", ctypes.c_uint32),  # Unused, zero
        ("issued_ns", ctypes.c_uint64),  # When it was published [ns]
        ("saved_ns", ctypes.c_uint64),  # The same on the clock that the times of the state are of, also on another host; 0 when it is not known [ns]
        ("bytes", ctypes.c_uint8 * 12800),  # The state
    ]

    @staticmethod
    def type_name() -> str:
        return "scanloop.Checkpoint.v4"


class Truth(ctypes.Structure):
    """Topic truth, published once per scan by the emulated robot."""

    TOPIC = "truth"
    LAYOUT = 0xf003defc
    _fields_ = [
        ("header", Header),  # Identity of the scan published with it
        ("time_s", ctypes.c_double),  # Time since the start of the run at the front beam [s]
        ("x_m", ctypes.c_double),  # True position along the track [m]
        ("y_m", ctypes.c_double),  # True lateral position [m]
        ("yaw_rad", ctypes.c_double),  # True yaw [rad]
        ("sideslip_rad", ctypes.c_double),  # True sideslip [rad]
        ("yaw_rate_radps", ctypes.c_double),  # True yaw rate [rad/s]
        ("speed_mps", ctypes.c_double),  # True speed over ground, negative backwards [m/s]
        ("steering_rad", ctypes.c_double),  # True steering angle at the wheels [rad]
        ("clearance_m", ctypes.c_double),  # Distance of the body to the nearest obstacle or wall now; 1e9 when there is none [m]
        ("min_clearance_m", ctypes.c_double),  # Smallest such distance since the start, checked at each plant step [m]
        ("path_length_m", ctypes.c_double),  # Distance driven since the start [m]
        ("max_abs_lateral_m", ctypes.c_double),  # Largest lateral offset from the line y = start since the start [m]
        ("goal_distance_m", ctypes.c_double),  # Distance of the robot's centre to the goal [m]
        ("longest_blind_s", ctypes.c_double),  # Longest time that the wheels turned without a new actuation, checked at each plant step [s]
        ("actuation_age_s", ctypes.c_double),  # Time since the last actuation arrived [s]
        ("blocked", ctypes.c_uint32),  # 1 while the wheels are blocked
        ("collided", ctypes.c_uint32),  # 1 when the body has touched an obstacle or a wall while the wheels turned
        ("struck", ctypes.c_uint32),  # 1 when a moving obstacle has touched the body while it stood still
        ("dead_man", ctypes.c_uint32),  # 1 when the dead man of the robot has blocked the wheels
        ("actuation_scan", ctypes.c_uint64),  # Scan that the last actuation answered
        ("refused", ctypes.c_uint64),  # Actuations refused by the robot since the start: not finite or beyond its limits
        ("steps", ctypes.c_uint64),  # Plant steps since the start
        ("reserved", ctypes.c_uint64),  # Unused, zero
    ]

    @staticmethod
    def type_name() -> str:
        return "scanloop.Truth.v2"


class Journal(ctypes.Structure):
    """Topic journal, published by each process before each of its outputs."""

    TOPIC = "journal"
    LAYOUT = 0xe7bc8cba
    _fields_ = [
        ("header", Header),  # Identity, without stamps: the scan of the output that follows
        ("role", ctypes.c_uint32),  # Slot of the process; the first five are those of a `Role`
        ("length", ctypes.c_uint32),  # How many of `entries` are used
        ("output", ctypes.c_uint64),  # Sequence number of the output that follows on the first topic of the role; 0 when only more entries follow
        ("entries", JournalEntry * 20),  # What happened
    ]

    @staticmethod
    def type_name() -> str:
        return "scanloop.Journal.v2"


class ClockOffset(ctypes.Structure):
    """Topic clock, published once per scan and other host, by the link of the orchestrator's host."""

    TOPIC = "clock"
    LAYOUT = 0x94459935
    _fields_ = [
        ("header", Header),  # Identity: the scan; the chain is unused
        ("host", ctypes.c_uint8 * 16),  # Name of the host in ASCII, padded with zeros
        ("common_ns", ctypes.c_uint64),  # A moment on the clock of the orchestrator's host, as in all samples that were recorded there [ns]
        ("host_ns", ctypes.c_uint64),  # The same moment on the clock of the other host [ns]
        ("bound_ns", ctypes.c_uint64),  # What the two may be apart by in truth [ns]
    ]

    @staticmethod
    def type_name() -> str:
        return "scanloop.ClockOffset.v2"


# The sample of each topic.
TOPICS = {
    "scan": Scan,
    "odometry": Odometry,
    "pose": Pose,
    "obstacles": Obstacles,
    "command": Command,
    "actuation": Actuation,
    "heartbeat": Heartbeat,
    "directive": Directive,
    "checkpoint": Checkpoint,
    "truth": Truth,
    "journal": Journal,
    "clock": ClockOffset,
}
# What each role reads.
READS = {
    Role.ROBOT: [Actuation],
    Role.ESTIMATOR: [Odometry, Actuation, Scan],
    Role.OBSTACLES: [Scan, Pose],
    Role.CONTROLLER: [Pose, Obstacles],
    Role.ACTUATOR: [Command],
}
# What each role writes.
WRITES = {
    Role.ROBOT: [Scan, Odometry],
    Role.ESTIMATOR: [Pose],
    Role.OBSTACLES: [Obstacles],
    Role.CONTROLLER: [Command],
    Role.ACTUATOR: [Actuation],
}


_KINDS = {
    ctypes.c_uint8: "u8",
    ctypes.c_uint16: "u16",
    ctypes.c_uint32: "u32",
    ctypes.c_uint64: "u64",
    ctypes.c_int32: "i32",
    ctypes.c_double: "f64",
}


def layouts():
    """The fields of all samples as ctypes lays them out: (topic, field, kind, count, size, offset).

    A struct comes before its fields, of an array the first element stands for all, and "." is a sample as a whole.
    """
    rows = []

    def add(topic, around, start, structure):
        for name, kind in structure._fields_:
            offset = start + getattr(structure, name).offset
            count = 1
            if issubclass(kind, ctypes.Array):
                kind, count = kind._type_, kind._length_
            rows.append((topic, around + name, _KINDS.get(kind, kind.__name__), count, ctypes.sizeof(kind), offset))
            if issubclass(kind, ctypes.Structure):
                add(topic, around + name + ".", offset, kind)

    for topic, sample in TOPICS.items():
        rows.append((topic, ".", sample.type_name(), 1, ctypes.sizeof(sample), 0))
        add(topic, "", 0, sample)
    return rows
