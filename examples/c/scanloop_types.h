/* The samples of Scanloop. Made by `scanloop types --c`: do not edit, make it again.
 *
 * C11, fixed layout, no padding; lengths in metres, angles in radians counter-clockwise, x along the track, y to the
 * left. The assertions hold each struct to the layout it was made from; the table at the end is computed by your
 * compiler, and a process whose table differs from that of the system is refused with the field that differs. */
#ifndef SCANLOOP_TYPES_H
#define SCANLOOP_TYPES_H

#include <stddef.h>
#include <stdint.h>

#define SCANLOOP_ROLES 5 /* Number of roles */
#define SCANLOOP_SLOTS 8 /* Largest number of processes in the loop */
#define SCANLOOP_MAX_BEAMS 2048 /* Largest number of beams of a scan */
#define SCANLOOP_BEAMS 682 /* Number of beams of the URG-04LX */
#define SCANLOOP_FRONT_BEAM 340 /* Index of its beam that looks straight ahead */
#define SCANLOOP_FIRST_ANALYSED_BEAM 170 /* Its first beam analysed for obstacles, 60 deg to the right */
#define SCANLOOP_LAST_ANALYSED_BEAM 511 /* Its last beam analysed for obstacles, 60 deg to the left */
#define SCANLOOP_MIN_RANGE_MM 20 /* Ranges below this are error codes: no return [mm] */
#define SCANLOOP_PITCH_RAD 0.006135923151542565 /* Angle between two of its beams [rad] */
#define SCANLOOP_FIRST_BEAM_YAW_RAD -2.086213871524472 /* Angle of its beam 0, counter-clockwise from straight ahead [rad] */
#define SCANLOOP_SECTOR_BEAMS 11 /* Beams of one sector of evidence */
#define SCANLOOP_MAX_OBSTACLES 16 /* How many ellipses a description can hold */
#define SCANLOOP_PLAN_NODES 25 /* How many nodes of the plan a command carries */
#define SCANLOOP_CHECKPOINT_BYTES 12800 /* How many bytes of state a checkpoint can hold */
#define SCANLOOP_JOURNAL_ENTRIES 20 /* How many entries a journal can hold */
#define SCANLOOP_DEVICE_REASON_BYTES 96 /* How many bytes the reason of a device can have */

#define SCANLOOP_TOPIC_SCAN "scan"
#define SCANLOOP_TOPIC_ODOMETRY "odometry"
#define SCANLOOP_TOPIC_POSE "pose"
#define SCANLOOP_TOPIC_OBSTACLES "obstacles"
#define SCANLOOP_TOPIC_COMMAND "command"
#define SCANLOOP_TOPIC_ACTUATION "actuation"
#define SCANLOOP_TOPIC_HEARTBEAT "heartbeat"
#define SCANLOOP_TOPIC_DIRECTIVE "directive"
#define SCANLOOP_TOPIC_CHECKPOINT "checkpoint"
#define SCANLOOP_TOPIC_TRUTH "truth"
#define SCANLOOP_TOPIC_JOURNAL "journal"
#define SCANLOOP_TOPIC_CLOCK "clock"

/* The job of one process of the loop. */
enum scanloop_role {
    SCANLOOP_ROLE_ROBOT = 0, /* Moves and measures: the emulated SUMMIT with its scanner, or a driver of a real robot. */
    SCANLOOP_ROLE_ESTIMATOR = 1, /* Corrects measured data and estimates the pose. */
    SCANLOOP_ROLE_OBSTACLES = 2, /* Describes obstacles as ellipses. */
    SCANLOOP_ROLE_CONTROLLER = 3, /* Plans and commands velocity and steering. */
    SCANLOOP_ROLE_ACTUATOR = 4, /* Corrects and limits commands, and blocks the wheels when it must. */
};

/* What the whole system is doing. */
enum scanloop_phase {
    SCANLOOP_PHASE_STARTING = 0, /* Processes are starting and open their ports. */
    SCANLOOP_PHASE_CONNECTING = 1, /* All ports exist: each process makes its ends of the connections. */
    SCANLOOP_PHASE_DRIVING = 2, /* The loop runs. */
    SCANLOOP_PHASE_STOPPING = 3, /* Wheels are blocked and processes end. */
};

/* The state that a process reports. */
enum scanloop_process_state {
    SCANLOOP_PROCESS_STATE_ATTACHED = 0, /* It has opened its ports. */
    SCANLOOP_PROCESS_STATE_CONNECTED = 1, /* Its connections are made, samples will arrive. */
    SCANLOOP_PROCESS_STATE_READY = 2, /* It has published its first output. */
    SCANLOOP_PROCESS_STATE_ENDING = 3, /* It is about to end. */
};

/* What the devices behind a process do. */
enum scanloop_device_state {
    SCANLOOP_DEVICE_STATE_NONE = 0, /* The process has none, or does not report them. */
    SCANLOOP_DEVICE_STATE_CONNECTING = 1, /* One of them is being connected or started. */
    SCANLOOP_DEVICE_STATE_RUNNING = 2, /* All of them deliver data. */
    SCANLOOP_DEVICE_STATE_FAULT = 3, /* One of them can't be used, or has stopped delivering data. */
};

/* What the estimator suspects to be calibrated wrongly. */
enum scanloop_suspect {
    SCANLOOP_SUSPECT_NONE = 0, /* Nothing. */
    SCANLOOP_SUSPECT_VELOCITY_FACTOR = 1, /* The velocity factor kv: the speed at the wheels is not the desired one. */
    SCANLOOP_SUSPECT_STEERING = 2, /* The steering map: the robot turns otherwise than commanded. */
    SCANLOOP_SUSPECT_ODOMETRY_LONGITUDINAL = 3, /* Odometry scale error, df: fraction of the travelled distance that is not reported. */
    SCANLOOP_SUSPECT_ODOMETRY_LATERAL_RATE = 4, /* The lateral drift of the odometry, dds. */
    SCANLOOP_SUSPECT_HEADING = 5, /* The reported heading jumped. */
    SCANLOOP_SUSPECT_POSITION = 6, /* The reported position jumped. */
    SCANLOOP_SUSPECT_VEHICLE = 7, /* The vehicle description: the model makes a motion of it that no robot can have. */
};

/* What the ranges of the scanner can be used for. */
enum scanloop_scanner_state {
    SCANLOOP_SCANNER_STATE_HEALTHY = 0, /* Returns come where earlier scans predict them. */
    SCANLOOP_SCANNER_STATE_DEGRADED = 1, /* Many returns are missing or wrong: drive slowly. */
    SCANLOOP_SCANNER_STATE_BLIND = 2, /* Too few returns come to see an obstacle in time: block the wheels. */
    SCANLOOP_SCANNER_STATE_STUCK = 3, /* The same ranges are repeated while the robot moves: block the wheels. */
    SCANLOOP_SCANNER_STATE_CONTRADICTORY = 4, /* The ranges contradict the motion of the robot: block the wheels. */
};

/* What the estimator asks for because of its suspicion. */
enum scanloop_alarm {
    SCANLOOP_ALARM_NONE = 0, /* Nothing. */
    SCANLOOP_ALARM_SLOW = 1, /* Drive slowly. */
    SCANLOOP_ALARM_STOP = 2, /* Block the wheels. */
};

/* What the command asks for. */
enum scanloop_command_kind {
    SCANLOOP_COMMAND_KIND_STOP = 0, /* Block the wheels for safety. */
    SCANLOOP_COMMAND_KIND_DRIVE = 1, /* Drive with the velocity and steering angle of the command. */
    SCANLOOP_COMMAND_KIND_LAND = 2, /* Block the wheels because the goal is reached. */
};

/* Where a command comes from: the rung of the ladder that was reached. */
enum scanloop_level {
    SCANLOOP_LEVEL_STOP = 0, /* Wheels blocked. */
    SCANLOOP_LEVEL_CONVERGED = 1, /* The converged and verified solution for this scan. */
    SCANLOOP_LEVEL_BEST_ITERATE = 2, /* The best verified iterate for this scan. */
    SCANLOOP_LEVEL_LAST_PLAN = 3, /* The rest of the last verified plan, verified again against the obstacles of this scan. */
    SCANLOOP_LEVEL_PERSON = 4, /* What a person asks for, verified. */
};

/* How the optimal control problem was solved. */
enum scanloop_solve_status {
    SCANLOOP_SOLVE_STATUS_NOT_SOLVED = 0, /* No problem was solved for this command. */
    SCANLOOP_SOLVE_STATUS_CONVERGED = 1, /* The KKT residual is within its tolerance. */
    SCANLOOP_SOLVE_STATUS_MAX_ITERATIONS = 2, /* The iteration limit came first; the best iterate is in the command. */
    SCANLOOP_SOLVE_STATUS_OUT_OF_TIME = 3, /* The time budget came first; the best iterate is in the command. */
    SCANLOOP_SOLVE_STATUS_FAILED = 4, /* No step could be computed. */
};

/* Why the controller asks to block the wheels. */
enum scanloop_stop_reason {
    SCANLOOP_STOP_REASON_NONE = 0, /* It does not. */
    SCANLOOP_STOP_REASON_LANDED = 1, /* The goal is reached. */
    SCANLOOP_STOP_REASON_BLOCKED = 2, /* The path is blocked, or too near to steer around. */
    SCANLOOP_STOP_REASON_UNVERIFIED = 3, /* No plan of this scan or the last could be verified. */
    SCANLOOP_STOP_REASON_BAD_INPUT = 4, /* The inputs contradict each other or the bounds. */
    SCANLOOP_STOP_REASON_GOAL_PASSED = 5, /* The goal was passed and cannot be reached any more. */
    SCANLOOP_STOP_REASON_NO_INPUT = 6, /* No input came in time. */
    SCANLOOP_STOP_REASON_SELF_CHECK = 7, /* The estimator suspects a wrong calibration. */
    SCANLOOP_STOP_REASON_STATE_LOST = 8, /* The state of the process before was lost while the robot drove: it comes to rest first. */
    SCANLOOP_STOP_REASON_NO_SAFE_SPEED = 9, /* At no speed can the robot stop in time: scans are too rare or the data too old. */
    SCANLOOP_STOP_REASON_SCANNER = 10, /* The scanner is blind, stuck or contradictory: obstacles would not be seen. */
    SCANLOOP_STOP_REASON_COVERED_BY_OBSTACLE = 11, /* A described obstacle covers the robot: the obstacle detector is wrong. */
    SCANLOOP_STOP_REASON_PAUSED = 12, /* A person has paused the drive. */
    SCANLOOP_STOP_REASON_RELEASED = 13, /* The person who drives asks for no motion, or is silent. */
    SCANLOOP_STOP_REASON_REVERSAL = 14, /* The robot stands to change between forwards and backwards. */
    SCANLOOP_STOP_REASON_UNSEEN = 15, /* Backwards, every plan leads to ground that the scanner has not shown. */
};

/* Who drives the robot. */
enum scanloop_driven_by {
    SCANLOOP_DRIVEN_BY_CONTROLLER = 0, /* The controller, to its goal. */
    SCANLOOP_DRIVEN_BY_NOBODY = 1, /* The drive is paused: wheels are blocked, and all processes stay ready. */
    SCANLOOP_DRIVEN_BY_PERSON = 2, /* A person, by what `GivenControl` says. */
};

/* What the robot is told. */
enum scanloop_actuation_kind {
    SCANLOOP_ACTUATION_KIND_BLOCK = 0, /* Block the wheels. */
    SCANLOOP_ACTUATION_KIND_DRIVE = 1, /* Turn the wheels with the velocity and angle sent. */
};

/* Why the actuator blocks the wheels. */
enum scanloop_block_reason {
    SCANLOOP_BLOCK_REASON_NONE = 0, /* It does not. */
    SCANLOOP_BLOCK_REASON_LANDED = 1, /* The goal is reached. */
    SCANLOOP_BLOCK_REASON_COMMANDED = 2, /* The controller asked for a stop. */
    SCANLOOP_BLOCK_REASON_NO_COMMAND = 3, /* No valid command came within 1.5 scan periods. */
    SCANLOOP_BLOCK_REASON_INVALID_COMMAND = 4, /* The command was not finite, not verified, or outside its hard limits. */
    SCANLOOP_BLOCK_REASON_STALE_COMMAND = 5, /* The scan behind the command is too old. */
    SCANLOOP_BLOCK_REASON_STOP_REQUESTED = 6, /* The user or the orchestrator asked for a stop. */
    SCANLOOP_BLOCK_REASON_START = 7, /* Nothing has been commanded yet. */
    SCANLOOP_BLOCK_REASON_PAUSED = 8, /* A person has paused the drive. */
    SCANLOOP_BLOCK_REASON_RELEASED = 9, /* The person who drives is silent. */
    SCANLOOP_BLOCK_REASON_EMERGENCY_STOP = 10, /* An emergency stop from outside is pressed, or silent. */
};

/* The rule that a dropped or refused sample failed. */
enum scanloop_rule {
    SCANLOOP_RULE_NONE = 0, /* It failed none. */
    SCANLOOP_RULE_FOREIGN_LAYOUT = 1, /* Its layout is that of this system. */
    SCANLOOP_RULE_NOT_FINITE = 2, /* Its numbers are finite. */
    SCANLOOP_RULE_OUT_OF_RANGE = 3, /* Its numbers are within the ranges of the fields. */
    SCANLOOP_RULE_UNKNOWN_VALUE = 4, /* Its enumerations hold known numbers. */
    SCANLOOP_RULE_NOT_VERIFIED = 5, /* A command to drive was verified. */
    SCANLOOP_RULE_OUTSIDE_BOUNDS = 6, /* A command to drive is within the hard limits of the actuator. */
    SCANLOOP_RULE_TOO_OLD = 7, /* Its scan is young enough. */
    SCANLOOP_RULE_FROM_THE_FUTURE = 8, /* Its scan does not lie in the future. */
    SCANLOOP_RULE_ANSWERED_BEFORE = 9, /* Its scan was not answered before. */
    SCANLOOP_RULE_IMPOSSIBLE_NUMBER = 10, /* Its numbers are such as its scan and its publisher can have reached. */
    SCANLOOP_RULE_STILL_ROLLING = 11, /* A command to drive the other way finds the robot at rest. */
};

/* What an entry of a journal states. */
enum scanloop_journal_kind {
    SCANLOOP_JOURNAL_KIND_NONE = 0, /* Nothing. */
    SCANLOOP_JOURNAL_KIND_TAKEN = 1, /* The process took a sample: `topic`, `incarnation`, and its sequence number in `value`. */
    SCANLOOP_JOURNAL_KIND_USED = 2, /* What was taken last is used; `value` is the time that the stage is told [ns]. */
    SCANLOOP_JOURNAL_KIND_TIMER = 3, /* A timeout did something, at the time `value` [ns]. */
    SCANLOOP_JOURNAL_KIND_BUDGET = 4, /* The time budget ended a solution, which had read the clock `value` times before. */
    SCANLOOP_JOURNAL_KIND_STOPPED = 5, /* The wheels are blocked for a stop, at the time `value` [ns]. */
    SCANLOOP_JOURNAL_KIND_RELEASED = 6, /* A stop has ended. */
    SCANLOOP_JOURNAL_KIND_DROPPED = 7, /* Commands were dropped before the process saw them. */
    SCANLOOP_JOURNAL_KIND_HELD_BACK = 8, /* The output that follows would have driven: the port made it a block. */
    SCANLOOP_JOURNAL_KIND_BEGUN = 9, /* The process begins, at the time `value` [ns]. */
    SCANLOOP_JOURNAL_KIND_BEGUN_IN_STOP = 10, /* The process begins in stop, because the state of the one before it is lost. */
    SCANLOOP_JOURNAL_KIND_RESUMED = 11, /* The process continues from a checkpoint: `incarnation` has published it, with the sequence number `value`. */
    SCANLOOP_JOURNAL_KIND_SAVED = 12, /* The process has published its checkpoint with the sequence number `value`. */
    SCANLOOP_JOURNAL_KIND_INJECTED = 13, /* An injected fault has changed a sample behind the process: `topic`, `incarnation`, and its sequence number in `value`. */
    SCANLOOP_JOURNAL_KIND_ALTERED = 14, /* An injected fault alters the emulated robot from now on (`value` 1), or no longer (0). */
    SCANLOOP_JOURNAL_KIND_MOVED = 15, /* The sample or state of the next entry was handed over with its times moved by `value` [ns], in two's complement. */
    SCANLOOP_JOURNAL_KIND_EMERGENCY_STOP = 16, /* The wheels are blocked for an emergency stop, at the time `value` [ns]. */
    SCANLOOP_JOURNAL_KIND_OWN = 17, /* A sample of a topic of your own was read, of the scan `value`; its fields follow. */
    SCANLOOP_JOURNAL_KIND_NUMBER = 18, /* The next field of that sample: the bits of an f64 in `value`. */
};

/* A part of samples. */
typedef struct scanloop_stage_stamps {
    uint64_t woken_ns; /* When the stage was woken for the scan [ns] */
    uint64_t taken_ns; /* When all of its inputs were taken [ns] */
    uint64_t computed_ns; /* When its computation was done [ns] */
    uint64_t published_ns; /* When its output was published [ns] */
} scanloop_stage_stamps;
_Static_assert(sizeof(scanloop_stage_stamps) == 32, "scanloop_stage_stamps");
_Static_assert(offsetof(scanloop_stage_stamps, woken_ns) == 0, "scanloop_stage_stamps.woken_ns");
_Static_assert(offsetof(scanloop_stage_stamps, taken_ns) == 8, "scanloop_stage_stamps.taken_ns");
_Static_assert(offsetof(scanloop_stage_stamps, computed_ns) == 16, "scanloop_stage_stamps.computed_ns");
_Static_assert(offsetof(scanloop_stage_stamps, published_ns) == 24, "scanloop_stage_stamps.published_ns");

/* A part of samples. */
typedef struct scanloop_header {
    uint32_t layout; /* Layout version of the sample, `Sample::LAYOUT` */
    uint32_t incarnation; /* Incarnation of the producer: one number per started process, given by the orchestrator */
    uint64_t scan_id; /* The scan that this sample belongs to; the first scan of a run is 1 */
    uint64_t sequence; /* Number of the sample among those of its producer on its topic, from 1 without gaps */
    uint64_t acquired_ns; /* When the front beam of the scan was taken [ns] */
    scanloop_stage_stamps chain[8]; /* Stamps of all stages on the way to this sample, by slot: the five roles come first */
} scanloop_header;
_Static_assert(sizeof(scanloop_header) == 288, "scanloop_header");
_Static_assert(offsetof(scanloop_header, layout) == 0, "scanloop_header.layout");
_Static_assert(offsetof(scanloop_header, incarnation) == 4, "scanloop_header.incarnation");
_Static_assert(offsetof(scanloop_header, scan_id) == 8, "scanloop_header.scan_id");
_Static_assert(offsetof(scanloop_header, sequence) == 16, "scanloop_header.sequence");
_Static_assert(offsetof(scanloop_header, acquired_ns) == 24, "scanloop_header.acquired_ns");
_Static_assert(offsetof(scanloop_header, chain) == 32, "scanloop_header.chain");

/* A part of samples. */
typedef struct scanloop_scanner_health {
    uint32_t state; /* Whether and how fast the robot may drive with these ranges, `ScannerState` */
    uint32_t identical_scans; /* Scans in a row with the ranges of the scan before, while the robot moved */
    uint64_t unseen_sectors; /* Sectors without evidence, one bit each: sector k has the beams 11 k to 11 k + 10 */
    double valid_share; /* Share of the window's beams with a valid range */
    double returned_share; /* Share of the returns that came where earlier scans predict them; 1 where none are predicted */
    double blind_s; /* Time since the last scan with ranges; zero when this one has them [s] */
    double seen_ahead_m; /* Farthest distance ahead, from the robot's centre, at which nothing that appears can be missed [m] */
    double range_factor; /* Estimated ratio of the reported ranges to the true ones */
    double range_offset_m; /* Estimated length added to the reported ranges [m] */
    double yaw_error_rad; /* Estimated error of the mounting angle, counter-clockwise [rad] */
} scanloop_scanner_health;
_Static_assert(sizeof(scanloop_scanner_health) == 72, "scanloop_scanner_health");
_Static_assert(offsetof(scanloop_scanner_health, state) == 0, "scanloop_scanner_health.state");
_Static_assert(offsetof(scanloop_scanner_health, identical_scans) == 4, "scanloop_scanner_health.identical_scans");
_Static_assert(offsetof(scanloop_scanner_health, unseen_sectors) == 8, "scanloop_scanner_health.unseen_sectors");
_Static_assert(offsetof(scanloop_scanner_health, valid_share) == 16, "scanloop_scanner_health.valid_share");
_Static_assert(offsetof(scanloop_scanner_health, returned_share) == 24, "scanloop_scanner_health.returned_share");
_Static_assert(offsetof(scanloop_scanner_health, blind_s) == 32, "scanloop_scanner_health.blind_s");
_Static_assert(offsetof(scanloop_scanner_health, seen_ahead_m) == 40, "scanloop_scanner_health.seen_ahead_m");
_Static_assert(offsetof(scanloop_scanner_health, range_factor) == 48, "scanloop_scanner_health.range_factor");
_Static_assert(offsetof(scanloop_scanner_health, range_offset_m) == 56, "scanloop_scanner_health.range_offset_m");
_Static_assert(offsetof(scanloop_scanner_health, yaw_error_rad) == 64, "scanloop_scanner_health.yaw_error_rad");

/* A part of samples. */
typedef struct scanloop_obstacle {
    uint32_t id; /* Identity of the ellipse, kept while it is tracked; never 0 */
    uint32_t body; /* Identity of the body that the ellipse belongs to */
    double x_m; /* Centre of the ellipse along the track, (7.32) [m] */
    double y_m; /* Centre of the ellipse across the track, (7.33) [m] */
    double a_m; /* Semi-axis along the track, a of (7.34) [m] */
    double b_m; /* Semi-axis across the track, b of (7.35) [m] */
    double velocity_x_mps; /* Velocity along the track [m/s] */
    double velocity_y_mps; /* Velocity across the track [m/s] */
    double velocity_covariance[3]; /* Covariance of the velocity: xx, xy, yy [m^2/s^2] */
    double box_x_m; /* Centre of the body's box along the track [m] */
    double box_y_m; /* Centre of the body's box across the track [m] */
    double box_length_m; /* Full length of the body's box along its own axis [m] */
    double box_width_m; /* Full width of the body's box [m] */
    double box_yaw_rad; /* Direction of the box's length axis [rad] */
    double unseen_s; /* Time since the body was last seen; zero when this scan shows it [s] */
    uint64_t sightings; /* Scans that showed the body since it was first seen */
} scanloop_obstacle;
_Static_assert(sizeof(scanloop_obstacle) == 136, "scanloop_obstacle");
_Static_assert(offsetof(scanloop_obstacle, id) == 0, "scanloop_obstacle.id");
_Static_assert(offsetof(scanloop_obstacle, body) == 4, "scanloop_obstacle.body");
_Static_assert(offsetof(scanloop_obstacle, x_m) == 8, "scanloop_obstacle.x_m");
_Static_assert(offsetof(scanloop_obstacle, y_m) == 16, "scanloop_obstacle.y_m");
_Static_assert(offsetof(scanloop_obstacle, a_m) == 24, "scanloop_obstacle.a_m");
_Static_assert(offsetof(scanloop_obstacle, b_m) == 32, "scanloop_obstacle.b_m");
_Static_assert(offsetof(scanloop_obstacle, velocity_x_mps) == 40, "scanloop_obstacle.velocity_x_mps");
_Static_assert(offsetof(scanloop_obstacle, velocity_y_mps) == 48, "scanloop_obstacle.velocity_y_mps");
_Static_assert(offsetof(scanloop_obstacle, velocity_covariance) == 56, "scanloop_obstacle.velocity_covariance");
_Static_assert(offsetof(scanloop_obstacle, box_x_m) == 80, "scanloop_obstacle.box_x_m");
_Static_assert(offsetof(scanloop_obstacle, box_y_m) == 88, "scanloop_obstacle.box_y_m");
_Static_assert(offsetof(scanloop_obstacle, box_length_m) == 96, "scanloop_obstacle.box_length_m");
_Static_assert(offsetof(scanloop_obstacle, box_width_m) == 104, "scanloop_obstacle.box_width_m");
_Static_assert(offsetof(scanloop_obstacle, box_yaw_rad) == 112, "scanloop_obstacle.box_yaw_rad");
_Static_assert(offsetof(scanloop_obstacle, unseen_s) == 120, "scanloop_obstacle.unseen_s");
_Static_assert(offsetof(scanloop_obstacle, sightings) == 128, "scanloop_obstacle.sightings");

/* A part of samples. */
typedef struct scanloop_margin {
    double base_m; /* Distance kept in any case [m] */
    double pose_m; /* Uncertainty of the pose relative to the obstacles, along the plan [m] */
    double latency_m; /* Speed times the age of the data when the command acts [m] */
    double model_m; /* Difference between the robot and its description [m] */
    double perception_m; /* Uncertainty of the described obstacles [m] */
} scanloop_margin;
_Static_assert(sizeof(scanloop_margin) == 40, "scanloop_margin");
_Static_assert(offsetof(scanloop_margin, base_m) == 0, "scanloop_margin.base_m");
_Static_assert(offsetof(scanloop_margin, pose_m) == 8, "scanloop_margin.pose_m");
_Static_assert(offsetof(scanloop_margin, latency_m) == 16, "scanloop_margin.latency_m");
_Static_assert(offsetof(scanloop_margin, model_m) == 24, "scanloop_margin.model_m");
_Static_assert(offsetof(scanloop_margin, perception_m) == 32, "scanloop_margin.perception_m");

/* A part of samples. */
typedef struct scanloop_blocking {
    double x_m; /* Position of its centre along the track [m] */
    double y_m; /* Lateral position of its centre [m] */
    double gap_m; /* The widest gap past it that the robot's body could use, negative when there is none [m] */
    double needed_m; /* The gap that the robot needs there: its body and the margin on both sides [m] */
    uint32_t id; /* Identity of the ellipse, 0 when no obstacle is the reason */
    uint32_t reserved; /* Unused, zero */
} scanloop_blocking;
_Static_assert(sizeof(scanloop_blocking) == 40, "scanloop_blocking");
_Static_assert(offsetof(scanloop_blocking, x_m) == 0, "scanloop_blocking.x_m");
_Static_assert(offsetof(scanloop_blocking, y_m) == 8, "scanloop_blocking.y_m");
_Static_assert(offsetof(scanloop_blocking, gap_m) == 16, "scanloop_blocking.gap_m");
_Static_assert(offsetof(scanloop_blocking, needed_m) == 24, "scanloop_blocking.needed_m");
_Static_assert(offsetof(scanloop_blocking, id) == 32, "scanloop_blocking.id");
_Static_assert(offsetof(scanloop_blocking, reserved) == 36, "scanloop_blocking.reserved");

/* A part of samples. */
typedef struct scanloop_sides {
    double left_objective; /* Objective of the plan that passes the obstacle on its left, negative without such a plan */
    double right_objective; /* The same on its right */
    uint32_t id; /* Identity of the ellipse, 0 when no sides were compared */
    uint32_t reserved; /* Unused, zero */
} scanloop_sides;
_Static_assert(sizeof(scanloop_sides) == 24, "scanloop_sides");
_Static_assert(offsetof(scanloop_sides, left_objective) == 0, "scanloop_sides.left_objective");
_Static_assert(offsetof(scanloop_sides, right_objective) == 8, "scanloop_sides.right_objective");
_Static_assert(offsetof(scanloop_sides, id) == 16, "scanloop_sides.id");
_Static_assert(offsetof(scanloop_sides, reserved) == 20, "scanloop_sides.reserved");

/* A part of samples. */
typedef struct scanloop_plan_node {
    double x_m; /* Position along the track [m] */
    double y_m; /* Lateral position [m] */
    double yaw_rad; /* Yaw [rad] */
    double sideslip_rad; /* Sideslip [rad] */
    double yaw_rate_radps; /* Yaw rate [rad/s] */
    double velocity_mps; /* Velocity from this node to the next [m/s] */
    double steering_rad; /* Steering angle from this node to the next [rad] */
} scanloop_plan_node;
_Static_assert(sizeof(scanloop_plan_node) == 56, "scanloop_plan_node");
_Static_assert(offsetof(scanloop_plan_node, x_m) == 0, "scanloop_plan_node.x_m");
_Static_assert(offsetof(scanloop_plan_node, y_m) == 8, "scanloop_plan_node.y_m");
_Static_assert(offsetof(scanloop_plan_node, yaw_rad) == 16, "scanloop_plan_node.yaw_rad");
_Static_assert(offsetof(scanloop_plan_node, sideslip_rad) == 24, "scanloop_plan_node.sideslip_rad");
_Static_assert(offsetof(scanloop_plan_node, yaw_rate_radps) == 32, "scanloop_plan_node.yaw_rate_radps");
_Static_assert(offsetof(scanloop_plan_node, velocity_mps) == 40, "scanloop_plan_node.velocity_mps");
_Static_assert(offsetof(scanloop_plan_node, steering_rad) == 48, "scanloop_plan_node.steering_rad");

/* A part of samples. */
typedef struct scanloop_span {
    uint32_t incarnation; /* Incarnation of the writer; 0 for an entry that is not used */
    uint32_t reserved; /* Unused, zero */
    uint64_t first; /* First sequence number */
    uint64_t last; /* Last sequence number */
} scanloop_span;
_Static_assert(sizeof(scanloop_span) == 24, "scanloop_span");
_Static_assert(offsetof(scanloop_span, incarnation) == 0, "scanloop_span.incarnation");
_Static_assert(offsetof(scanloop_span, reserved) == 4, "scanloop_span.reserved");
_Static_assert(offsetof(scanloop_span, first) == 8, "scanloop_span.first");
_Static_assert(offsetof(scanloop_span, last) == 16, "scanloop_span.last");

/* A part of samples. */
typedef struct scanloop_input_account {
    scanloop_span writers[4]; /* Sequence numbers that arrived, per writer */
    scanloop_span hole; /* The newest sequence numbers that did not arrive */
    scanloop_span twice; /* The newest sequence number that arrived twice */
    scanloop_span late; /* The newest sequence number that arrived after a later one */
    uint64_t arrived; /* Samples that arrived, repeated ones included */
    uint64_t used; /* Used */
    uint64_t replaced; /* Replaced in the process by newer ones before they were used */
    uint64_t overwritten; /* Overwritten by newer ones in the buffer before they were taken from the bus */
    uint64_t stale; /* Dropped because they were too old */
    uint64_t foreign; /* Dropped because their writer had no authority for their scan */
    uint64_t invalid; /* Dropped because of their content */
    uint64_t duplicate; /* Dropped because their number had arrived before */
    uint64_t reordered; /* Dropped because a later number had arrived before */
    uint64_t missing; /* Sequence numbers that never arrived although the buffer was not full */
    uint64_t open; /* Samples whose fate is not known yet */
    uint64_t open_sum; /* Sum of their sequence numbers */
    uint64_t waiting; /* Samples that wait in the process; equal to `open` if no sample has disappeared */
    uint64_t waiting_sum; /* Sum of the sequence numbers of samples that wait */
    uint64_t unreadable; /* Samples of another layout, whose sequence numbers cannot be read */
} scanloop_input_account;
_Static_assert(sizeof(scanloop_input_account) == 288, "scanloop_input_account");
_Static_assert(offsetof(scanloop_input_account, writers) == 0, "scanloop_input_account.writers");
_Static_assert(offsetof(scanloop_input_account, hole) == 96, "scanloop_input_account.hole");
_Static_assert(offsetof(scanloop_input_account, twice) == 120, "scanloop_input_account.twice");
_Static_assert(offsetof(scanloop_input_account, late) == 144, "scanloop_input_account.late");
_Static_assert(offsetof(scanloop_input_account, arrived) == 168, "scanloop_input_account.arrived");
_Static_assert(offsetof(scanloop_input_account, used) == 176, "scanloop_input_account.used");
_Static_assert(offsetof(scanloop_input_account, replaced) == 184, "scanloop_input_account.replaced");
_Static_assert(offsetof(scanloop_input_account, overwritten) == 192, "scanloop_input_account.overwritten");
_Static_assert(offsetof(scanloop_input_account, stale) == 200, "scanloop_input_account.stale");
_Static_assert(offsetof(scanloop_input_account, foreign) == 208, "scanloop_input_account.foreign");
_Static_assert(offsetof(scanloop_input_account, invalid) == 216, "scanloop_input_account.invalid");
_Static_assert(offsetof(scanloop_input_account, duplicate) == 224, "scanloop_input_account.duplicate");
_Static_assert(offsetof(scanloop_input_account, reordered) == 232, "scanloop_input_account.reordered");
_Static_assert(offsetof(scanloop_input_account, missing) == 240, "scanloop_input_account.missing");
_Static_assert(offsetof(scanloop_input_account, open) == 248, "scanloop_input_account.open");
_Static_assert(offsetof(scanloop_input_account, open_sum) == 256, "scanloop_input_account.open_sum");
_Static_assert(offsetof(scanloop_input_account, waiting) == 264, "scanloop_input_account.waiting");
_Static_assert(offsetof(scanloop_input_account, waiting_sum) == 272, "scanloop_input_account.waiting_sum");
_Static_assert(offsetof(scanloop_input_account, unreadable) == 280, "scanloop_input_account.unreadable");

/* A part of samples. */
typedef struct scanloop_refusal {
    uint64_t count; /* Samples dropped or refused because of their content, since the process started */
    uint64_t scan_id; /* Scan of the newest one */
    double value; /* Faulty value in the newest one; 0 if it is not finite */
    uint32_t incarnation; /* Incarnation of the writer of the newest one */
    uint32_t rule; /* Rule that the newest one violates, `Rule` */
    uint8_t field[32]; /* Name of its faulty field in ASCII, padded with zeros */
} scanloop_refusal;
_Static_assert(sizeof(scanloop_refusal) == 64, "scanloop_refusal");
_Static_assert(offsetof(scanloop_refusal, count) == 0, "scanloop_refusal.count");
_Static_assert(offsetof(scanloop_refusal, scan_id) == 8, "scanloop_refusal.scan_id");
_Static_assert(offsetof(scanloop_refusal, value) == 16, "scanloop_refusal.value");
_Static_assert(offsetof(scanloop_refusal, incarnation) == 24, "scanloop_refusal.incarnation");
_Static_assert(offsetof(scanloop_refusal, rule) == 28, "scanloop_refusal.rule");
_Static_assert(offsetof(scanloop_refusal, field) == 32, "scanloop_refusal.field");

/* A part of samples. */
typedef struct scanloop_device {
    uint32_t state; /* What they do, `DeviceState` */
    uint32_t reserved; /* Unused, zero */
    uint64_t since_ns; /* Since when they do it; 0 while it is not known [ns of CLOCK_MONOTONIC] */
    uint8_t reason[96]; /* Why, in a few words of UTF-8, padded with zeros */
} scanloop_device;
_Static_assert(sizeof(scanloop_device) == 112, "scanloop_device");
_Static_assert(offsetof(scanloop_device, state) == 0, "scanloop_device.state");
_Static_assert(offsetof(scanloop_device, reserved) == 4, "scanloop_device.reserved");
_Static_assert(offsetof(scanloop_device, since_ns) == 8, "scanloop_device.since_ns");
_Static_assert(offsetof(scanloop_device, reason) == 16, "scanloop_device.reason");

/* A part of samples. */
typedef struct scanloop_authority {
    uint32_t incarnation; /* The incarnation whose samples count from `from_scan` on; 0 accepts none */
    uint32_t previous; /* The incarnation whose samples count before `from_scan` */
    uint64_t from_scan; /* The scan at which authority changes */
} scanloop_authority;
_Static_assert(sizeof(scanloop_authority) == 16, "scanloop_authority");
_Static_assert(offsetof(scanloop_authority, incarnation) == 0, "scanloop_authority.incarnation");
_Static_assert(offsetof(scanloop_authority, previous) == 4, "scanloop_authority.previous");
_Static_assert(offsetof(scanloop_authority, from_scan) == 8, "scanloop_authority.from_scan");

/* A part of samples. */
typedef struct scanloop_given_goal {
    uint64_t from_scan; /* The first scan for which it counts; later goals count from later scans */
    uint32_t index; /* Which goal of the drive it replaces, from 0 */
    uint32_t has_yaw; /* 1 when the robot has to stand there in the direction `yaw_rad` */
    double x_m; /* Position along the course; on a line that of the track [m] */
    double y_m; /* Position to the left of the course [m] */
    double tolerance_m; /* Distance within which it is reached [m] */
    double yaw_rad; /* Direction of the robot there, in the plane [rad] */
    double yaw_tolerance_rad; /* Largest difference from that direction [rad] */
    double stay_s; /* How long the robot stands there before it drives to the next goal [s] */
} scanloop_given_goal;
_Static_assert(sizeof(scanloop_given_goal) == 64, "scanloop_given_goal");
_Static_assert(offsetof(scanloop_given_goal, from_scan) == 0, "scanloop_given_goal.from_scan");
_Static_assert(offsetof(scanloop_given_goal, index) == 8, "scanloop_given_goal.index");
_Static_assert(offsetof(scanloop_given_goal, has_yaw) == 12, "scanloop_given_goal.has_yaw");
_Static_assert(offsetof(scanloop_given_goal, x_m) == 16, "scanloop_given_goal.x_m");
_Static_assert(offsetof(scanloop_given_goal, y_m) == 24, "scanloop_given_goal.y_m");
_Static_assert(offsetof(scanloop_given_goal, tolerance_m) == 32, "scanloop_given_goal.tolerance_m");
_Static_assert(offsetof(scanloop_given_goal, yaw_rad) == 40, "scanloop_given_goal.yaw_rad");
_Static_assert(offsetof(scanloop_given_goal, yaw_tolerance_rad) == 48, "scanloop_given_goal.yaw_tolerance_rad");
_Static_assert(offsetof(scanloop_given_goal, stay_s) == 56, "scanloop_given_goal.stay_s");

/* A part of samples. */
typedef struct scanloop_given_control {
    uint64_t number; /* Ascends with each that is given */
    uint64_t given_ns; /* When it was given [ns of the loop's clock] */
    double velocity_mps; /* Velocity; below the smallest one of the robot it is to stand [m/s] */
    double steering_rad; /* Steering angle [rad] */
} scanloop_given_control;
_Static_assert(sizeof(scanloop_given_control) == 32, "scanloop_given_control");
_Static_assert(offsetof(scanloop_given_control, number) == 0, "scanloop_given_control.number");
_Static_assert(offsetof(scanloop_given_control, given_ns) == 8, "scanloop_given_control.given_ns");
_Static_assert(offsetof(scanloop_given_control, velocity_mps) == 16, "scanloop_given_control.velocity_mps");
_Static_assert(offsetof(scanloop_given_control, steering_rad) == 24, "scanloop_given_control.steering_rad");

/* A part of samples. */
typedef struct scanloop_journal_entry {
    uint16_t kind; /* What it states, `JournalKind` */
    uint16_t topic; /* Topic of the sample, by its place in the table of topics */
    uint32_t incarnation; /* Incarnation that has published the sample */
    uint64_t value; /* A sequence number, a time [ns] or a count */
} scanloop_journal_entry;
_Static_assert(sizeof(scanloop_journal_entry) == 16, "scanloop_journal_entry");
_Static_assert(offsetof(scanloop_journal_entry, kind) == 0, "scanloop_journal_entry.kind");
_Static_assert(offsetof(scanloop_journal_entry, topic) == 2, "scanloop_journal_entry.topic");
_Static_assert(offsetof(scanloop_journal_entry, incarnation) == 4, "scanloop_journal_entry.incarnation");
_Static_assert(offsetof(scanloop_journal_entry, value) == 8, "scanloop_journal_entry.value");

/* Topic scan, published once per scan, at the end of the sweep. */
typedef struct scanloop_scan {
    scanloop_header header; /* Identity and stamps; acquired is the time of the front beam */
    uint64_t sweep_ns; /* How long the sweep over all beams lasts, two thirds of the scan period [ns] */
    uint64_t period_ns; /* Time between the end of one scan and the end of the next [ns] */
    double first_rad; /* Angle of beam 0 from straight ahead, counter-clockwise [rad] */
    double increment_rad; /* Angle from one beam to the next; negative where the sweep is clockwise [rad] */
    uint32_t beams; /* How many beams there are: as many of `ranges_mm` count */
    uint32_t missing; /* 1 when the scanner gave no ranges for this scan: all of them are zero */
    uint32_t ranges_mm[2048]; /* Range per beam in the order of the sweep; below 20 is an error code: no return [mm] */
} scanloop_scan;
_Static_assert(sizeof(scanloop_scan) == 8520, "scanloop_scan");
_Static_assert(offsetof(scanloop_scan, header) == 0, "scanloop_scan.header");
_Static_assert(offsetof(scanloop_scan, sweep_ns) == 288, "scanloop_scan.sweep_ns");
_Static_assert(offsetof(scanloop_scan, period_ns) == 296, "scanloop_scan.period_ns");
_Static_assert(offsetof(scanloop_scan, first_rad) == 304, "scanloop_scan.first_rad");
_Static_assert(offsetof(scanloop_scan, increment_rad) == 312, "scanloop_scan.increment_rad");
_Static_assert(offsetof(scanloop_scan, beams) == 320, "scanloop_scan.beams");
_Static_assert(offsetof(scanloop_scan, missing) == 324, "scanloop_scan.missing");
_Static_assert(offsetof(scanloop_scan, ranges_mm) == 328, "scanloop_scan.ranges_mm");

/* Topic odometry, published once per scan, at the end of the sweep. */
typedef struct scanloop_odometry {
    scanloop_header header; /* Identity and stamps; same scan id as the scan published with it */
    double x_m; /* Reported position along the track [m] */
    double y_m; /* Reported lateral position, left positive [m] */
    double yaw_rad; /* Reported yaw, in (-pi, pi] [rad] */
    double dx_m; /* Reported x minus the x reported before; zero in the first sample [m] */
    double dy_m; /* Reported y minus the y reported before; zero in the first sample [m] */
    double dyaw_rad; /* Reported yaw minus the yaw reported before; zero in the first sample [rad] */
    double dt_s; /* Time since the sample before; zero in the first sample [s] */
    double speed_mps; /* Speed over ground measured at the wheels, negative backwards [m/s] */
} scanloop_odometry;
_Static_assert(sizeof(scanloop_odometry) == 352, "scanloop_odometry");
_Static_assert(offsetof(scanloop_odometry, header) == 0, "scanloop_odometry.header");
_Static_assert(offsetof(scanloop_odometry, x_m) == 288, "scanloop_odometry.x_m");
_Static_assert(offsetof(scanloop_odometry, y_m) == 296, "scanloop_odometry.y_m");
_Static_assert(offsetof(scanloop_odometry, yaw_rad) == 304, "scanloop_odometry.yaw_rad");
_Static_assert(offsetof(scanloop_odometry, dx_m) == 312, "scanloop_odometry.dx_m");
_Static_assert(offsetof(scanloop_odometry, dy_m) == 320, "scanloop_odometry.dy_m");
_Static_assert(offsetof(scanloop_odometry, dyaw_rad) == 328, "scanloop_odometry.dyaw_rad");
_Static_assert(offsetof(scanloop_odometry, dt_s) == 336, "scanloop_odometry.dt_s");
_Static_assert(offsetof(scanloop_odometry, speed_mps) == 344, "scanloop_odometry.speed_mps");

/* Topic pose, published once per odometry sample. */
typedef struct scanloop_pose {
    scanloop_header header; /* Identity and stamps */
    double yaw_rad; /* Estimated yaw at the acquisition of the scan, x2 of (7.28) [rad] */
    double x_m; /* Estimated position along the track at the acquisition of the scan, x4 of (7.30) [m] */
    double y_m; /* Estimated lateral position at the acquisition of the scan, x5 of (7.31) [m] */
    double covariance[9]; /* Covariance of (yaw, x, y) on the track, row by row [rad^2, rad m, m^2] */
    double local_covariance[9]; /* Covariance of (yaw, x, y) relative to what the scanner sees now, row by row: without the drift of the odometry */
    double speed_mps; /* Speed over ground at the acquisition of the scan, negative backwards [m/s] */
    double sideslip_rad; /* Sideslip at the acquisition of the scan, x1 of (7.27) [rad] */
    double yaw_rate_radps; /* Yaw rate at the acquisition of the scan, x3 of (7.29) [rad/s] */
    uint64_t predicted_ns; /* When the command for this scan is expected to act: the time of the predicted state [ns] */
    double predicted_sideslip_rad; /* Predicted sideslip [rad] */
    double predicted_yaw_rad; /* Predicted yaw [rad] */
    double predicted_yaw_rate_radps; /* Predicted yaw rate [rad/s] */
    double predicted_x_m; /* Predicted position along the track [m] */
    double predicted_y_m; /* Predicted lateral position [m] */
    double predicted_speed_mps; /* Predicted speed, negative backwards [m/s] */
    double innovation[3]; /* Measured minus predicted (yaw, x, y) of the measurement update [rad, m, m] */
    double gain[9]; /* Kalman gain of (yaw, x, y), row by row */
    double nis; /* Normalised innovation squared */
    uint64_t rejected; /* Measurements refused by the gate since the start */
    double learned[6]; /* What the estimator has learned of the robot: turn rate [rad/s], shares of the distance and of the turn that the */
    double learned_deviation[6]; /* Their standard deviations; 0 for what is not learned */
    uint32_t suspect; /* Part of the calibration that is suspected to be wrong, `Suspect` */
    uint32_t alarm; /* Reaction that the estimator asks for because of it, `Alarm` */
} scanloop_pose;
_Static_assert(sizeof(scanloop_pose) == 752, "scanloop_pose");
_Static_assert(offsetof(scanloop_pose, header) == 0, "scanloop_pose.header");
_Static_assert(offsetof(scanloop_pose, yaw_rad) == 288, "scanloop_pose.yaw_rad");
_Static_assert(offsetof(scanloop_pose, x_m) == 296, "scanloop_pose.x_m");
_Static_assert(offsetof(scanloop_pose, y_m) == 304, "scanloop_pose.y_m");
_Static_assert(offsetof(scanloop_pose, covariance) == 312, "scanloop_pose.covariance");
_Static_assert(offsetof(scanloop_pose, local_covariance) == 384, "scanloop_pose.local_covariance");
_Static_assert(offsetof(scanloop_pose, speed_mps) == 456, "scanloop_pose.speed_mps");
_Static_assert(offsetof(scanloop_pose, sideslip_rad) == 464, "scanloop_pose.sideslip_rad");
_Static_assert(offsetof(scanloop_pose, yaw_rate_radps) == 472, "scanloop_pose.yaw_rate_radps");
_Static_assert(offsetof(scanloop_pose, predicted_ns) == 480, "scanloop_pose.predicted_ns");
_Static_assert(offsetof(scanloop_pose, predicted_sideslip_rad) == 488, "scanloop_pose.predicted_sideslip_rad");
_Static_assert(offsetof(scanloop_pose, predicted_yaw_rad) == 496, "scanloop_pose.predicted_yaw_rad");
_Static_assert(offsetof(scanloop_pose, predicted_yaw_rate_radps) == 504, "scanloop_pose.predicted_yaw_rate_radps");
_Static_assert(offsetof(scanloop_pose, predicted_x_m) == 512, "scanloop_pose.predicted_x_m");
_Static_assert(offsetof(scanloop_pose, predicted_y_m) == 520, "scanloop_pose.predicted_y_m");
_Static_assert(offsetof(scanloop_pose, predicted_speed_mps) == 528, "scanloop_pose.predicted_speed_mps");
_Static_assert(offsetof(scanloop_pose, innovation) == 536, "scanloop_pose.innovation");
_Static_assert(offsetof(scanloop_pose, gain) == 560, "scanloop_pose.gain");
_Static_assert(offsetof(scanloop_pose, nis) == 632, "scanloop_pose.nis");
_Static_assert(offsetof(scanloop_pose, rejected) == 640, "scanloop_pose.rejected");
_Static_assert(offsetof(scanloop_pose, learned) == 648, "scanloop_pose.learned");
_Static_assert(offsetof(scanloop_pose, learned_deviation) == 696, "scanloop_pose.learned_deviation");
_Static_assert(offsetof(scanloop_pose, suspect) == 744, "scanloop_pose.suspect");
_Static_assert(offsetof(scanloop_pose, alarm) == 748, "scanloop_pose.alarm");

/* Topic obstacles, published once per scan, when scan and pose are there. */
typedef struct scanloop_obstacles {
    scanloop_header header; /* Identity and stamps */
    uint32_t count; /* How many of `items` are used */
    uint32_t overflow; /* Number of ellipses for which `items` had no room */
    scanloop_scanner_health scanner; /* What the scanner can be relied on for */
    scanloop_obstacle items[16]; /* The ellipses, nearest ahead first; unused ones are zero */
} scanloop_obstacles;
_Static_assert(sizeof(scanloop_obstacles) == 2544, "scanloop_obstacles");
_Static_assert(offsetof(scanloop_obstacles, header) == 0, "scanloop_obstacles.header");
_Static_assert(offsetof(scanloop_obstacles, count) == 288, "scanloop_obstacles.count");
_Static_assert(offsetof(scanloop_obstacles, overflow) == 292, "scanloop_obstacles.overflow");
_Static_assert(offsetof(scanloop_obstacles, scanner) == 296, "scanloop_obstacles.scanner");
_Static_assert(offsetof(scanloop_obstacles, items) == 368, "scanloop_obstacles.items");

/* Topic command, published once per scan, when pose and obstacles are there. */
typedef struct scanloop_command {
    scanloop_header header; /* Identity and stamps */
    uint32_t kind; /* What the controller asks for, `CommandKind` */
    uint32_t level; /* Where the command comes from, `Level` */
    uint32_t status; /* How the problem was solved, `SolveStatus` */
    uint32_t reason; /* Why the wheels are to be blocked, `StopReason` */
    uint32_t verified; /* 1 when the plan was verified: bounds, obstacles and model */
    int32_t side; /* Side on which the nearest obstacle in the way is passed: 1 left, -1 right, 0 none */
    uint32_t iterations; /* SQP iterations */
    uint32_t active_constraints; /* Active constraints at the solution */
    double velocity_mps; /* Desired velocity, u1 of (7.27)-(7.31), negative backwards [m/s] */
    double steering_rad; /* Desired steering angle, u2 of (7.27)-(7.31) [rad] */
    double kkt_residual; /* Infinity norm of the KKT conditions */
    double largest_violation; /* Largest violation of a hard constraint or of the model */
    double slack; /* Largest slack of an ellipse */
    double objective; /* Value of the objective */
    uint64_t solve_ns; /* Time the solver used, zero in lock-step [ns] */
    uint64_t plan_start_ns; /* Time of the first node of the plan [ns] */
    double plan_interval_s; /* Time between two nodes of the plan [s] */
    double speed_limit_mps; /* Largest velocity at which the robot can still stop in time [m/s] */
    scanloop_margin margin; /* The clearance that the plan keeps */
    scanloop_blocking blocking; /* The obstacle that a stop is for, or for which a person drives slower than it asks */
    scanloop_sides sides; /* What passing an obstacle on each side would cost */
    uint32_t plan_length; /* How many of `plan` are used */
    uint32_t reserved; /* Unused, zero */
    scanloop_plan_node plan[25]; /* The planned nodes */
} scanloop_command;
_Static_assert(sizeof(scanloop_command) == 1912, "scanloop_command");
_Static_assert(offsetof(scanloop_command, header) == 0, "scanloop_command.header");
_Static_assert(offsetof(scanloop_command, kind) == 288, "scanloop_command.kind");
_Static_assert(offsetof(scanloop_command, level) == 292, "scanloop_command.level");
_Static_assert(offsetof(scanloop_command, status) == 296, "scanloop_command.status");
_Static_assert(offsetof(scanloop_command, reason) == 300, "scanloop_command.reason");
_Static_assert(offsetof(scanloop_command, verified) == 304, "scanloop_command.verified");
_Static_assert(offsetof(scanloop_command, side) == 308, "scanloop_command.side");
_Static_assert(offsetof(scanloop_command, iterations) == 312, "scanloop_command.iterations");
_Static_assert(offsetof(scanloop_command, active_constraints) == 316, "scanloop_command.active_constraints");
_Static_assert(offsetof(scanloop_command, velocity_mps) == 320, "scanloop_command.velocity_mps");
_Static_assert(offsetof(scanloop_command, steering_rad) == 328, "scanloop_command.steering_rad");
_Static_assert(offsetof(scanloop_command, kkt_residual) == 336, "scanloop_command.kkt_residual");
_Static_assert(offsetof(scanloop_command, largest_violation) == 344, "scanloop_command.largest_violation");
_Static_assert(offsetof(scanloop_command, slack) == 352, "scanloop_command.slack");
_Static_assert(offsetof(scanloop_command, objective) == 360, "scanloop_command.objective");
_Static_assert(offsetof(scanloop_command, solve_ns) == 368, "scanloop_command.solve_ns");
_Static_assert(offsetof(scanloop_command, plan_start_ns) == 376, "scanloop_command.plan_start_ns");
_Static_assert(offsetof(scanloop_command, plan_interval_s) == 384, "scanloop_command.plan_interval_s");
_Static_assert(offsetof(scanloop_command, speed_limit_mps) == 392, "scanloop_command.speed_limit_mps");
_Static_assert(offsetof(scanloop_command, margin) == 400, "scanloop_command.margin");
_Static_assert(offsetof(scanloop_command, blocking) == 440, "scanloop_command.blocking");
_Static_assert(offsetof(scanloop_command, sides) == 480, "scanloop_command.sides");
_Static_assert(offsetof(scanloop_command, plan_length) == 504, "scanloop_command.plan_length");
_Static_assert(offsetof(scanloop_command, reserved) == 508, "scanloop_command.reserved");
_Static_assert(offsetof(scanloop_command, plan) == 512, "scanloop_command.plan");

/* Topic actuation, published once per command, and when the actuator blocks the wheels by itself. */
typedef struct scanloop_actuation {
    scanloop_header header; /* Identity and stamps of the command answered */
    uint32_t kind; /* What the robot is asked to do, `ActuationKind` */
    uint32_t reason; /* Why the wheels are blocked, `BlockReason` */
    uint32_t stop_reason; /* `StopReason` of the command that this answers */
    uint32_t answers; /* 1 when this answers a command of the scan in the header, 0 when the actuator acts by itself */
    double desired_velocity_mps; /* Desired velocity after limits (7.41), negative backwards [m/s] */
    double desired_steering_rad; /* Desired steering angle after limits (7.41) [rad] */
    double sent_velocity_mps; /* Velocity sent to the robot, after the correction, negative backwards [m/s] */
    double sent_steering_rad; /* Steering angle sent to the robot, after the correction [rad] */
    uint64_t refused; /* Commands refused since the start: not finite, not verified, stale, out of limits */
    uint64_t gaps; /* Gaps between scans since the start: the wheels were blocked, and the next valid command ended the block */
    uint32_t driven_by; /* Who drives, `DrivenBy` */
    uint32_t reserved; /* Unused, zero */
} scanloop_actuation;
_Static_assert(sizeof(scanloop_actuation) == 360, "scanloop_actuation");
_Static_assert(offsetof(scanloop_actuation, header) == 0, "scanloop_actuation.header");
_Static_assert(offsetof(scanloop_actuation, kind) == 288, "scanloop_actuation.kind");
_Static_assert(offsetof(scanloop_actuation, reason) == 292, "scanloop_actuation.reason");
_Static_assert(offsetof(scanloop_actuation, stop_reason) == 296, "scanloop_actuation.stop_reason");
_Static_assert(offsetof(scanloop_actuation, answers) == 300, "scanloop_actuation.answers");
_Static_assert(offsetof(scanloop_actuation, desired_velocity_mps) == 304, "scanloop_actuation.desired_velocity_mps");
_Static_assert(offsetof(scanloop_actuation, desired_steering_rad) == 312, "scanloop_actuation.desired_steering_rad");
_Static_assert(offsetof(scanloop_actuation, sent_velocity_mps) == 320, "scanloop_actuation.sent_velocity_mps");
_Static_assert(offsetof(scanloop_actuation, sent_steering_rad) == 328, "scanloop_actuation.sent_steering_rad");
_Static_assert(offsetof(scanloop_actuation, refused) == 336, "scanloop_actuation.refused");
_Static_assert(offsetof(scanloop_actuation, gaps) == 344, "scanloop_actuation.gaps");
_Static_assert(offsetof(scanloop_actuation, driven_by) == 352, "scanloop_actuation.driven_by");
_Static_assert(offsetof(scanloop_actuation, reserved) == 356, "scanloop_actuation.reserved");

/* Topic heartbeat, published ten times a second by each process, and at each change of its state. */
typedef struct scanloop_heartbeat {
    scanloop_header header; /* Identity; scan id is the last one worked on, the chain is unused */
    uint32_t role; /* Slot of the process; the first five are those of a `Role` */
    uint32_t state; /* State that the process reports, `ProcessState` */
    uint64_t pid; /* Process id */
    uint32_t obeys_stop; /* 1 when it sees the stop word of its run, and so obeys `scanloop stop` by itself */
    uint32_t reserved; /* Unused, zero */
    uint64_t issued_ns; /* When it was published [ns of CLOCK_MONOTONIC] */
    uint64_t activations; /* Passes through the loop of the process; they stop when it hangs */
    uint64_t published; /* Outputs published on the first topic of the role */
    uint64_t used; /* Inputs used */
    uint64_t replaced; /* Inputs replaced by newer ones before they were used */
    uint64_t invalid; /* Inputs dropped because of their content */
    uint64_t stale; /* Inputs dropped because they were too old */
    uint64_t duplicate; /* Inputs dropped because their sequence number had been seen */
    uint64_t reordered; /* Inputs dropped because a later one had been seen */
    uint64_t foreign; /* Inputs dropped because their producer has no authority */
    uint64_t missing; /* Sequence numbers that never arrived */
    uint64_t undelivered; /* Outputs that did not reach all of their readers */
    uint64_t timeouts; /* Wake-ups by timeout */
    uint64_t looked_ns; /* When samples were last taken from the bus [ns of CLOCK_MONOTONIC] */
    uint64_t taken; /* Samples taken of the topic that the role answers */
    uint64_t taken_scans; /* Sum of their scan ids */
    uint64_t answered; /* Answers to them */
    uint64_t answered_scans; /* Sum of the scan ids of the answers */
    uint64_t written[4]; /* Sequence number of the newest sample per topic that the process writes, in the order of its writes */
    scanloop_input_account inputs[4]; /* What became of the samples per topic that the process reads, in the order of its reads */
    scanloop_refusal refused[4]; /* Samples dropped or refused because of their content, per topic that the process reads */
    scanloop_device device; /* What the devices behind the process do */
} scanloop_heartbeat;
_Static_assert(sizeof(scanloop_heartbeat) == 2008, "scanloop_heartbeat");
_Static_assert(offsetof(scanloop_heartbeat, header) == 0, "scanloop_heartbeat.header");
_Static_assert(offsetof(scanloop_heartbeat, role) == 288, "scanloop_heartbeat.role");
_Static_assert(offsetof(scanloop_heartbeat, state) == 292, "scanloop_heartbeat.state");
_Static_assert(offsetof(scanloop_heartbeat, pid) == 296, "scanloop_heartbeat.pid");
_Static_assert(offsetof(scanloop_heartbeat, obeys_stop) == 304, "scanloop_heartbeat.obeys_stop");
_Static_assert(offsetof(scanloop_heartbeat, reserved) == 308, "scanloop_heartbeat.reserved");
_Static_assert(offsetof(scanloop_heartbeat, issued_ns) == 312, "scanloop_heartbeat.issued_ns");
_Static_assert(offsetof(scanloop_heartbeat, activations) == 320, "scanloop_heartbeat.activations");
_Static_assert(offsetof(scanloop_heartbeat, published) == 328, "scanloop_heartbeat.published");
_Static_assert(offsetof(scanloop_heartbeat, used) == 336, "scanloop_heartbeat.used");
_Static_assert(offsetof(scanloop_heartbeat, replaced) == 344, "scanloop_heartbeat.replaced");
_Static_assert(offsetof(scanloop_heartbeat, invalid) == 352, "scanloop_heartbeat.invalid");
_Static_assert(offsetof(scanloop_heartbeat, stale) == 360, "scanloop_heartbeat.stale");
_Static_assert(offsetof(scanloop_heartbeat, duplicate) == 368, "scanloop_heartbeat.duplicate");
_Static_assert(offsetof(scanloop_heartbeat, reordered) == 376, "scanloop_heartbeat.reordered");
_Static_assert(offsetof(scanloop_heartbeat, foreign) == 384, "scanloop_heartbeat.foreign");
_Static_assert(offsetof(scanloop_heartbeat, missing) == 392, "scanloop_heartbeat.missing");
_Static_assert(offsetof(scanloop_heartbeat, undelivered) == 400, "scanloop_heartbeat.undelivered");
_Static_assert(offsetof(scanloop_heartbeat, timeouts) == 408, "scanloop_heartbeat.timeouts");
_Static_assert(offsetof(scanloop_heartbeat, looked_ns) == 416, "scanloop_heartbeat.looked_ns");
_Static_assert(offsetof(scanloop_heartbeat, taken) == 424, "scanloop_heartbeat.taken");
_Static_assert(offsetof(scanloop_heartbeat, taken_scans) == 432, "scanloop_heartbeat.taken_scans");
_Static_assert(offsetof(scanloop_heartbeat, answered) == 440, "scanloop_heartbeat.answered");
_Static_assert(offsetof(scanloop_heartbeat, answered_scans) == 448, "scanloop_heartbeat.answered_scans");
_Static_assert(offsetof(scanloop_heartbeat, written) == 456, "scanloop_heartbeat.written");
_Static_assert(offsetof(scanloop_heartbeat, inputs) == 488, "scanloop_heartbeat.inputs");
_Static_assert(offsetof(scanloop_heartbeat, refused) == 1640, "scanloop_heartbeat.refused");
_Static_assert(offsetof(scanloop_heartbeat, device) == 1896, "scanloop_heartbeat.device");

/* Topic directive, published ten times a second by the orchestrator, and at each change. */
typedef struct scanloop_directive {
    scanloop_header header; /* Identity; the chain is unused */
    uint32_t phase; /* What the system is doing, `Phase` */
    uint32_t stop; /* 1 when the wheels are to be blocked now, whatever the controller commands */
    uint64_t granted_scan; /* In lock-step: the last scan that the robot may publish */
    uint64_t issued_ns; /* When it was published [ns of CLOCK_MONOTONIC] */
    uint64_t orchestrator_pid; /* Process id of the orchestrator */
    scanloop_authority authority[8]; /* Whose samples count, by slot */
    scanloop_given_goal goal; /* The goal that was given last while the system drives */
    uint32_t driven_by; /* Who drives, `DrivenBy` */
    uint32_t reserved; /* Unused, zero */
    scanloop_given_control person; /* What a person who drives asks for */
} scanloop_directive;
_Static_assert(sizeof(scanloop_directive) == 552, "scanloop_directive");
_Static_assert(offsetof(scanloop_directive, header) == 0, "scanloop_directive.header");
_Static_assert(offsetof(scanloop_directive, phase) == 288, "scanloop_directive.phase");
_Static_assert(offsetof(scanloop_directive, stop) == 292, "scanloop_directive.stop");
_Static_assert(offsetof(scanloop_directive, granted_scan) == 296, "scanloop_directive.granted_scan");
_Static_assert(offsetof(scanloop_directive, issued_ns) == 304, "scanloop_directive.issued_ns");
_Static_assert(offsetof(scanloop_directive, orchestrator_pid) == 312, "scanloop_directive.orchestrator_pid");
_Static_assert(offsetof(scanloop_directive, authority) == 320, "scanloop_directive.authority");
_Static_assert(offsetof(scanloop_directive, goal) == 448, "scanloop_directive.goal");
_Static_assert(offsetof(scanloop_directive, driven_by) == 512, "scanloop_directive.driven_by");
_Static_assert(offsetof(scanloop_directive, reserved) == 516, "scanloop_directive.reserved");
_Static_assert(offsetof(scanloop_directive, person) == 520, "scanloop_directive.person");

/* Topic checkpoint, published once per scan by each stateful process. */
typedef struct scanloop_checkpoint {
    scanloop_header header; /* Identity: the scan after which the state was taken */
    uint32_t role; /* Slot of the process; the first five are those of a `Role` */
    uint32_t state_layout; /* Fingerprint of the type of the state */
    uint32_t length; /* How many of `bytes` are used */
    uint32_t reserved; /* Unused, zero */
    uint64_t issued_ns; /* When it was published [ns] */
    uint64_t saved_ns; /* The same on the clock that the times of the state are of, also on another host; 0 when it is not known [ns] */
    uint8_t bytes[12800]; /* The state */
} scanloop_checkpoint;
_Static_assert(sizeof(scanloop_checkpoint) == 13120, "scanloop_checkpoint");
_Static_assert(offsetof(scanloop_checkpoint, header) == 0, "scanloop_checkpoint.header");
_Static_assert(offsetof(scanloop_checkpoint, role) == 288, "scanloop_checkpoint.role");
_Static_assert(offsetof(scanloop_checkpoint, state_layout) == 292, "scanloop_checkpoint.state_layout");
_Static_assert(offsetof(scanloop_checkpoint, length) == 296, "scanloop_checkpoint.length");
_Static_assert(offsetof(scanloop_checkpoint, reserved) == 300, "scanloop_checkpoint.reserved");
_Static_assert(offsetof(scanloop_checkpoint, issued_ns) == 304, "scanloop_checkpoint.issued_ns");
_Static_assert(offsetof(scanloop_checkpoint, saved_ns) == 312, "scanloop_checkpoint.saved_ns");
_Static_assert(offsetof(scanloop_checkpoint, bytes) == 320, "scanloop_checkpoint.bytes");

/* Topic truth, published once per scan by the emulated robot. */
typedef struct scanloop_truth {
    scanloop_header header; /* Identity of the scan published with it */
    double time_s; /* Time since the start of the run at the front beam [s] */
    double x_m; /* True position along the track [m] */
    double y_m; /* True lateral position [m] */
    double yaw_rad; /* True yaw [rad] */
    double sideslip_rad; /* True sideslip [rad] */
    double yaw_rate_radps; /* True yaw rate [rad/s] */
    double speed_mps; /* True speed over ground, negative backwards [m/s] */
    double steering_rad; /* True steering angle at the wheels [rad] */
    double clearance_m; /* Distance of the body to the nearest obstacle or wall now; 1e9 when there is none [m] */
    double min_clearance_m; /* Smallest such distance since the start, checked at each plant step [m] */
    double path_length_m; /* Distance driven since the start [m] */
    double max_abs_lateral_m; /* Largest lateral offset from the line y = start since the start [m] */
    double goal_distance_m; /* Distance of the robot's centre to the goal [m] */
    double longest_blind_s; /* Longest time that the wheels turned without a new actuation, checked at each plant step [s] */
    double actuation_age_s; /* Time since the last actuation arrived [s] */
    uint32_t blocked; /* 1 while the wheels are blocked */
    uint32_t collided; /* 1 when the body has touched an obstacle or a wall while the wheels turned */
    uint32_t struck; /* 1 when a moving obstacle has touched the body while it stood still */
    uint32_t dead_man; /* 1 when the dead man of the robot has blocked the wheels */
    uint64_t actuation_scan; /* Scan that the last actuation answered */
    uint64_t refused; /* Actuations refused by the robot since the start: not finite or beyond its limits */
    uint64_t steps; /* Plant steps since the start */
    uint64_t reserved; /* Unused, zero */
} scanloop_truth;
_Static_assert(sizeof(scanloop_truth) == 456, "scanloop_truth");
_Static_assert(offsetof(scanloop_truth, header) == 0, "scanloop_truth.header");
_Static_assert(offsetof(scanloop_truth, time_s) == 288, "scanloop_truth.time_s");
_Static_assert(offsetof(scanloop_truth, x_m) == 296, "scanloop_truth.x_m");
_Static_assert(offsetof(scanloop_truth, y_m) == 304, "scanloop_truth.y_m");
_Static_assert(offsetof(scanloop_truth, yaw_rad) == 312, "scanloop_truth.yaw_rad");
_Static_assert(offsetof(scanloop_truth, sideslip_rad) == 320, "scanloop_truth.sideslip_rad");
_Static_assert(offsetof(scanloop_truth, yaw_rate_radps) == 328, "scanloop_truth.yaw_rate_radps");
_Static_assert(offsetof(scanloop_truth, speed_mps) == 336, "scanloop_truth.speed_mps");
_Static_assert(offsetof(scanloop_truth, steering_rad) == 344, "scanloop_truth.steering_rad");
_Static_assert(offsetof(scanloop_truth, clearance_m) == 352, "scanloop_truth.clearance_m");
_Static_assert(offsetof(scanloop_truth, min_clearance_m) == 360, "scanloop_truth.min_clearance_m");
_Static_assert(offsetof(scanloop_truth, path_length_m) == 368, "scanloop_truth.path_length_m");
_Static_assert(offsetof(scanloop_truth, max_abs_lateral_m) == 376, "scanloop_truth.max_abs_lateral_m");
_Static_assert(offsetof(scanloop_truth, goal_distance_m) == 384, "scanloop_truth.goal_distance_m");
_Static_assert(offsetof(scanloop_truth, longest_blind_s) == 392, "scanloop_truth.longest_blind_s");
_Static_assert(offsetof(scanloop_truth, actuation_age_s) == 400, "scanloop_truth.actuation_age_s");
_Static_assert(offsetof(scanloop_truth, blocked) == 408, "scanloop_truth.blocked");
_Static_assert(offsetof(scanloop_truth, collided) == 412, "scanloop_truth.collided");
_Static_assert(offsetof(scanloop_truth, struck) == 416, "scanloop_truth.struck");
_Static_assert(offsetof(scanloop_truth, dead_man) == 420, "scanloop_truth.dead_man");
_Static_assert(offsetof(scanloop_truth, actuation_scan) == 424, "scanloop_truth.actuation_scan");
_Static_assert(offsetof(scanloop_truth, refused) == 432, "scanloop_truth.refused");
_Static_assert(offsetof(scanloop_truth, steps) == 440, "scanloop_truth.steps");
_Static_assert(offsetof(scanloop_truth, reserved) == 448, "scanloop_truth.reserved");

/* Topic journal, published by each process before each of its outputs. */
typedef struct scanloop_journal {
    scanloop_header header; /* Identity, without stamps: the scan of the output that follows */
    uint32_t role; /* Slot of the process; the first five are those of a `Role` */
    uint32_t length; /* How many of `entries` are used */
    uint64_t output; /* Sequence number of the output that follows on the first topic of the role; 0 when only more entries follow */
    scanloop_journal_entry entries[20]; /* What happened */
} scanloop_journal;
_Static_assert(sizeof(scanloop_journal) == 624, "scanloop_journal");
_Static_assert(offsetof(scanloop_journal, header) == 0, "scanloop_journal.header");
_Static_assert(offsetof(scanloop_journal, role) == 288, "scanloop_journal.role");
_Static_assert(offsetof(scanloop_journal, length) == 292, "scanloop_journal.length");
_Static_assert(offsetof(scanloop_journal, output) == 296, "scanloop_journal.output");
_Static_assert(offsetof(scanloop_journal, entries) == 304, "scanloop_journal.entries");

/* Topic clock, published once per scan and other host, by the link of the orchestrator's host. */
typedef struct scanloop_clock_offset {
    scanloop_header header; /* Identity: the scan; the chain is unused */
    uint8_t host[16]; /* Name of the host in ASCII, padded with zeros */
    uint64_t common_ns; /* A moment on the clock of the orchestrator's host, as in all samples that were recorded there [ns] */
    uint64_t host_ns; /* The same moment on the clock of the other host [ns] */
    uint64_t bound_ns; /* What the two may be apart by in truth [ns] */
} scanloop_clock_offset;
_Static_assert(sizeof(scanloop_clock_offset) == 328, "scanloop_clock_offset");
_Static_assert(offsetof(scanloop_clock_offset, header) == 0, "scanloop_clock_offset.header");
_Static_assert(offsetof(scanloop_clock_offset, host) == 288, "scanloop_clock_offset.host");
_Static_assert(offsetof(scanloop_clock_offset, common_ns) == 304, "scanloop_clock_offset.common_ns");
_Static_assert(offsetof(scanloop_clock_offset, host_ns) == 312, "scanloop_clock_offset.host_ns");
_Static_assert(offsetof(scanloop_clock_offset, bound_ns) == 320, "scanloop_clock_offset.bound_ns");

/* One field of one sample, as the compiler laid it out. */
typedef struct scanloop_layout_row {
    const char *topic;
    const char *field; /* with the structs around it; "." is the sample as a whole */
    const char *kind;
    uint32_t count;  /* elements of an array, else 1 */
    uint32_t size;   /* of one element [bytes] */
    uint32_t offset; /* from the beginning of the sample [bytes] */
} scanloop_layout_row;

#define SCANLOOP_AT(type, field) (((type *)0)->field)
#define SCANLOOP_KIND(value) \
    _Generic((value), uint8_t: "u8", uint16_t: "u16", uint32_t: "u32", uint64_t: "u64", int32_t: "i32", \
        double: "f64", default: "another")
#define SCANLOOP_SAMPLE(topic, type, kind) {topic, ".", kind, 1, sizeof(type), 0}
#define SCANLOOP_STRUCT(topic, type, name, kind, field) \
    {topic, name, kind, 1, sizeof SCANLOOP_AT(type, field), offsetof(type, field)}
#define SCANLOOP_STRUCTS(topic, type, name, kind, field) \
    {topic, name, kind, sizeof SCANLOOP_AT(type, field) / sizeof SCANLOOP_AT(type, field[0]), \
        sizeof SCANLOOP_AT(type, field[0]), offsetof(type, field)}
#define SCANLOOP_VALUE(topic, type, name, field) \
    SCANLOOP_STRUCT(topic, type, name, SCANLOOP_KIND(SCANLOOP_AT(type, field)), field)
#define SCANLOOP_VALUES(topic, type, name, field) \
    SCANLOOP_STRUCTS(topic, type, name, SCANLOOP_KIND(SCANLOOP_AT(type, field[0])), field)

static const scanloop_layout_row scanloop_layouts[] = {
    SCANLOOP_SAMPLE("scan", scanloop_scan, "scanloop.Scan.v3"),
    SCANLOOP_STRUCT("scan", scanloop_scan, "header", "Header", header),
    SCANLOOP_VALUE("scan", scanloop_scan, "header.layout", header.layout),
    SCANLOOP_VALUE("scan", scanloop_scan, "header.incarnation", header.incarnation),
    SCANLOOP_VALUE("scan", scanloop_scan, "header.scan_id", header.scan_id),
    SCANLOOP_VALUE("scan", scanloop_scan, "header.sequence", header.sequence),
    SCANLOOP_VALUE("scan", scanloop_scan, "header.acquired_ns", header.acquired_ns),
    SCANLOOP_STRUCTS("scan", scanloop_scan, "header.chain", "StageStamps", header.chain),
    SCANLOOP_VALUE("scan", scanloop_scan, "header.chain.woken_ns", header.chain[0].woken_ns),
    SCANLOOP_VALUE("scan", scanloop_scan, "header.chain.taken_ns", header.chain[0].taken_ns),
    SCANLOOP_VALUE("scan", scanloop_scan, "header.chain.computed_ns", header.chain[0].computed_ns),
    SCANLOOP_VALUE("scan", scanloop_scan, "header.chain.published_ns", header.chain[0].published_ns),
    SCANLOOP_VALUE("scan", scanloop_scan, "sweep_ns", sweep_ns),
    SCANLOOP_VALUE("scan", scanloop_scan, "period_ns", period_ns),
    SCANLOOP_VALUE("scan", scanloop_scan, "first_rad", first_rad),
    SCANLOOP_VALUE("scan", scanloop_scan, "increment_rad", increment_rad),
    SCANLOOP_VALUE("scan", scanloop_scan, "beams", beams),
    SCANLOOP_VALUE("scan", scanloop_scan, "missing", missing),
    SCANLOOP_VALUES("scan", scanloop_scan, "ranges_mm", ranges_mm),
    SCANLOOP_SAMPLE("odometry", scanloop_odometry, "scanloop.Odometry.v2"),
    SCANLOOP_STRUCT("odometry", scanloop_odometry, "header", "Header", header),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "header.layout", header.layout),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "header.incarnation", header.incarnation),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "header.scan_id", header.scan_id),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "header.sequence", header.sequence),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "header.acquired_ns", header.acquired_ns),
    SCANLOOP_STRUCTS("odometry", scanloop_odometry, "header.chain", "StageStamps", header.chain),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "header.chain.woken_ns", header.chain[0].woken_ns),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "header.chain.taken_ns", header.chain[0].taken_ns),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "header.chain.computed_ns", header.chain[0].computed_ns),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "header.chain.published_ns", header.chain[0].published_ns),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "x_m", x_m),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "y_m", y_m),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "yaw_rad", yaw_rad),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "dx_m", dx_m),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "dy_m", dy_m),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "dyaw_rad", dyaw_rad),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "dt_s", dt_s),
    SCANLOOP_VALUE("odometry", scanloop_odometry, "speed_mps", speed_mps),
    SCANLOOP_SAMPLE("pose", scanloop_pose, "scanloop.Pose.v4"),
    SCANLOOP_STRUCT("pose", scanloop_pose, "header", "Header", header),
    SCANLOOP_VALUE("pose", scanloop_pose, "header.layout", header.layout),
    SCANLOOP_VALUE("pose", scanloop_pose, "header.incarnation", header.incarnation),
    SCANLOOP_VALUE("pose", scanloop_pose, "header.scan_id", header.scan_id),
    SCANLOOP_VALUE("pose", scanloop_pose, "header.sequence", header.sequence),
    SCANLOOP_VALUE("pose", scanloop_pose, "header.acquired_ns", header.acquired_ns),
    SCANLOOP_STRUCTS("pose", scanloop_pose, "header.chain", "StageStamps", header.chain),
    SCANLOOP_VALUE("pose", scanloop_pose, "header.chain.woken_ns", header.chain[0].woken_ns),
    SCANLOOP_VALUE("pose", scanloop_pose, "header.chain.taken_ns", header.chain[0].taken_ns),
    SCANLOOP_VALUE("pose", scanloop_pose, "header.chain.computed_ns", header.chain[0].computed_ns),
    SCANLOOP_VALUE("pose", scanloop_pose, "header.chain.published_ns", header.chain[0].published_ns),
    SCANLOOP_VALUE("pose", scanloop_pose, "yaw_rad", yaw_rad),
    SCANLOOP_VALUE("pose", scanloop_pose, "x_m", x_m),
    SCANLOOP_VALUE("pose", scanloop_pose, "y_m", y_m),
    SCANLOOP_VALUES("pose", scanloop_pose, "covariance", covariance),
    SCANLOOP_VALUES("pose", scanloop_pose, "local_covariance", local_covariance),
    SCANLOOP_VALUE("pose", scanloop_pose, "speed_mps", speed_mps),
    SCANLOOP_VALUE("pose", scanloop_pose, "sideslip_rad", sideslip_rad),
    SCANLOOP_VALUE("pose", scanloop_pose, "yaw_rate_radps", yaw_rate_radps),
    SCANLOOP_VALUE("pose", scanloop_pose, "predicted_ns", predicted_ns),
    SCANLOOP_VALUE("pose", scanloop_pose, "predicted_sideslip_rad", predicted_sideslip_rad),
    SCANLOOP_VALUE("pose", scanloop_pose, "predicted_yaw_rad", predicted_yaw_rad),
    SCANLOOP_VALUE("pose", scanloop_pose, "predicted_yaw_rate_radps", predicted_yaw_rate_radps),
    SCANLOOP_VALUE("pose", scanloop_pose, "predicted_x_m", predicted_x_m),
    SCANLOOP_VALUE("pose", scanloop_pose, "predicted_y_m", predicted_y_m),
    SCANLOOP_VALUE("pose", scanloop_pose, "predicted_speed_mps", predicted_speed_mps),
    SCANLOOP_VALUES("pose", scanloop_pose, "innovation", innovation),
    SCANLOOP_VALUES("pose", scanloop_pose, "gain", gain),
    SCANLOOP_VALUE("pose", scanloop_pose, "nis", nis),
    SCANLOOP_VALUE("pose", scanloop_pose, "rejected", rejected),
    SCANLOOP_VALUES("pose", scanloop_pose, "learned", learned),
    SCANLOOP_VALUES("pose", scanloop_pose, "learned_deviation", learned_deviation),
    SCANLOOP_VALUE("pose", scanloop_pose, "suspect", suspect),
    SCANLOOP_VALUE("pose", scanloop_pose, "alarm", alarm),
    SCANLOOP_SAMPLE("obstacles", scanloop_obstacles, "scanloop.Obstacles.v3"),
    SCANLOOP_STRUCT("obstacles", scanloop_obstacles, "header", "Header", header),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "header.layout", header.layout),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "header.incarnation", header.incarnation),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "header.scan_id", header.scan_id),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "header.sequence", header.sequence),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "header.acquired_ns", header.acquired_ns),
    SCANLOOP_STRUCTS("obstacles", scanloop_obstacles, "header.chain", "StageStamps", header.chain),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "header.chain.woken_ns", header.chain[0].woken_ns),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "header.chain.taken_ns", header.chain[0].taken_ns),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "header.chain.computed_ns", header.chain[0].computed_ns),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "header.chain.published_ns", header.chain[0].published_ns),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "count", count),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "overflow", overflow),
    SCANLOOP_STRUCT("obstacles", scanloop_obstacles, "scanner", "ScannerHealth", scanner),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "scanner.state", scanner.state),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "scanner.identical_scans", scanner.identical_scans),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "scanner.unseen_sectors", scanner.unseen_sectors),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "scanner.valid_share", scanner.valid_share),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "scanner.returned_share", scanner.returned_share),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "scanner.blind_s", scanner.blind_s),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "scanner.seen_ahead_m", scanner.seen_ahead_m),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "scanner.range_factor", scanner.range_factor),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "scanner.range_offset_m", scanner.range_offset_m),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "scanner.yaw_error_rad", scanner.yaw_error_rad),
    SCANLOOP_STRUCTS("obstacles", scanloop_obstacles, "items", "Obstacle", items),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "items.id", items[0].id),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "items.body", items[0].body),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "items.x_m", items[0].x_m),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "items.y_m", items[0].y_m),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "items.a_m", items[0].a_m),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "items.b_m", items[0].b_m),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "items.velocity_x_mps", items[0].velocity_x_mps),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "items.velocity_y_mps", items[0].velocity_y_mps),
    SCANLOOP_VALUES("obstacles", scanloop_obstacles, "items.velocity_covariance", items[0].velocity_covariance),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "items.box_x_m", items[0].box_x_m),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "items.box_y_m", items[0].box_y_m),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "items.box_length_m", items[0].box_length_m),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "items.box_width_m", items[0].box_width_m),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "items.box_yaw_rad", items[0].box_yaw_rad),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "items.unseen_s", items[0].unseen_s),
    SCANLOOP_VALUE("obstacles", scanloop_obstacles, "items.sightings", items[0].sightings),
    SCANLOOP_SAMPLE("command", scanloop_command, "scanloop.Command.v4"),
    SCANLOOP_STRUCT("command", scanloop_command, "header", "Header", header),
    SCANLOOP_VALUE("command", scanloop_command, "header.layout", header.layout),
    SCANLOOP_VALUE("command", scanloop_command, "header.incarnation", header.incarnation),
    SCANLOOP_VALUE("command", scanloop_command, "header.scan_id", header.scan_id),
    SCANLOOP_VALUE("command", scanloop_command, "header.sequence", header.sequence),
    SCANLOOP_VALUE("command", scanloop_command, "header.acquired_ns", header.acquired_ns),
    SCANLOOP_STRUCTS("command", scanloop_command, "header.chain", "StageStamps", header.chain),
    SCANLOOP_VALUE("command", scanloop_command, "header.chain.woken_ns", header.chain[0].woken_ns),
    SCANLOOP_VALUE("command", scanloop_command, "header.chain.taken_ns", header.chain[0].taken_ns),
    SCANLOOP_VALUE("command", scanloop_command, "header.chain.computed_ns", header.chain[0].computed_ns),
    SCANLOOP_VALUE("command", scanloop_command, "header.chain.published_ns", header.chain[0].published_ns),
    SCANLOOP_VALUE("command", scanloop_command, "kind", kind),
    SCANLOOP_VALUE("command", scanloop_command, "level", level),
    SCANLOOP_VALUE("command", scanloop_command, "status", status),
    SCANLOOP_VALUE("command", scanloop_command, "reason", reason),
    SCANLOOP_VALUE("command", scanloop_command, "verified", verified),
    SCANLOOP_VALUE("command", scanloop_command, "side", side),
    SCANLOOP_VALUE("command", scanloop_command, "iterations", iterations),
    SCANLOOP_VALUE("command", scanloop_command, "active_constraints", active_constraints),
    SCANLOOP_VALUE("command", scanloop_command, "velocity_mps", velocity_mps),
    SCANLOOP_VALUE("command", scanloop_command, "steering_rad", steering_rad),
    SCANLOOP_VALUE("command", scanloop_command, "kkt_residual", kkt_residual),
    SCANLOOP_VALUE("command", scanloop_command, "largest_violation", largest_violation),
    SCANLOOP_VALUE("command", scanloop_command, "slack", slack),
    SCANLOOP_VALUE("command", scanloop_command, "objective", objective),
    SCANLOOP_VALUE("command", scanloop_command, "solve_ns", solve_ns),
    SCANLOOP_VALUE("command", scanloop_command, "plan_start_ns", plan_start_ns),
    SCANLOOP_VALUE("command", scanloop_command, "plan_interval_s", plan_interval_s),
    SCANLOOP_VALUE("command", scanloop_command, "speed_limit_mps", speed_limit_mps),
    SCANLOOP_STRUCT("command", scanloop_command, "margin", "Margin", margin),
    SCANLOOP_VALUE("command", scanloop_command, "margin.base_m", margin.base_m),
    SCANLOOP_VALUE("command", scanloop_command, "margin.pose_m", margin.pose_m),
    SCANLOOP_VALUE("command", scanloop_command, "margin.latency_m", margin.latency_m),
    SCANLOOP_VALUE("command", scanloop_command, "margin.model_m", margin.model_m),
    SCANLOOP_VALUE("command", scanloop_command, "margin.perception_m", margin.perception_m),
    SCANLOOP_STRUCT("command", scanloop_command, "blocking", "Blocking", blocking),
    SCANLOOP_VALUE("command", scanloop_command, "blocking.x_m", blocking.x_m),
    SCANLOOP_VALUE("command", scanloop_command, "blocking.y_m", blocking.y_m),
    SCANLOOP_VALUE("command", scanloop_command, "blocking.gap_m", blocking.gap_m),
    SCANLOOP_VALUE("command", scanloop_command, "blocking.needed_m", blocking.needed_m),
    SCANLOOP_VALUE("command", scanloop_command, "blocking.id", blocking.id),
    SCANLOOP_VALUE("command", scanloop_command, "blocking.reserved", blocking.reserved),
    SCANLOOP_STRUCT("command", scanloop_command, "sides", "Sides", sides),
    SCANLOOP_VALUE("command", scanloop_command, "sides.left_objective", sides.left_objective),
    SCANLOOP_VALUE("command", scanloop_command, "sides.right_objective", sides.right_objective),
    SCANLOOP_VALUE("command", scanloop_command, "sides.id", sides.id),
    SCANLOOP_VALUE("command", scanloop_command, "sides.reserved", sides.reserved),
    SCANLOOP_VALUE("command", scanloop_command, "plan_length", plan_length),
    SCANLOOP_VALUE("command", scanloop_command, "reserved", reserved),
    SCANLOOP_STRUCTS("command", scanloop_command, "plan", "PlanNode", plan),
    SCANLOOP_VALUE("command", scanloop_command, "plan.x_m", plan[0].x_m),
    SCANLOOP_VALUE("command", scanloop_command, "plan.y_m", plan[0].y_m),
    SCANLOOP_VALUE("command", scanloop_command, "plan.yaw_rad", plan[0].yaw_rad),
    SCANLOOP_VALUE("command", scanloop_command, "plan.sideslip_rad", plan[0].sideslip_rad),
    SCANLOOP_VALUE("command", scanloop_command, "plan.yaw_rate_radps", plan[0].yaw_rate_radps),
    SCANLOOP_VALUE("command", scanloop_command, "plan.velocity_mps", plan[0].velocity_mps),
    SCANLOOP_VALUE("command", scanloop_command, "plan.steering_rad", plan[0].steering_rad),
    SCANLOOP_SAMPLE("actuation", scanloop_actuation, "scanloop.Actuation.v4"),
    SCANLOOP_STRUCT("actuation", scanloop_actuation, "header", "Header", header),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "header.layout", header.layout),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "header.incarnation", header.incarnation),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "header.scan_id", header.scan_id),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "header.sequence", header.sequence),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "header.acquired_ns", header.acquired_ns),
    SCANLOOP_STRUCTS("actuation", scanloop_actuation, "header.chain", "StageStamps", header.chain),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "header.chain.woken_ns", header.chain[0].woken_ns),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "header.chain.taken_ns", header.chain[0].taken_ns),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "header.chain.computed_ns", header.chain[0].computed_ns),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "header.chain.published_ns", header.chain[0].published_ns),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "kind", kind),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "reason", reason),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "stop_reason", stop_reason),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "answers", answers),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "desired_velocity_mps", desired_velocity_mps),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "desired_steering_rad", desired_steering_rad),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "sent_velocity_mps", sent_velocity_mps),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "sent_steering_rad", sent_steering_rad),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "refused", refused),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "gaps", gaps),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "driven_by", driven_by),
    SCANLOOP_VALUE("actuation", scanloop_actuation, "reserved", reserved),
    SCANLOOP_SAMPLE("heartbeat", scanloop_heartbeat, "scanloop.Heartbeat.v5"),
    SCANLOOP_STRUCT("heartbeat", scanloop_heartbeat, "header", "Header", header),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "header.layout", header.layout),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "header.incarnation", header.incarnation),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "header.scan_id", header.scan_id),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "header.sequence", header.sequence),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "header.acquired_ns", header.acquired_ns),
    SCANLOOP_STRUCTS("heartbeat", scanloop_heartbeat, "header.chain", "StageStamps", header.chain),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "header.chain.woken_ns", header.chain[0].woken_ns),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "header.chain.taken_ns", header.chain[0].taken_ns),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "header.chain.computed_ns", header.chain[0].computed_ns),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "header.chain.published_ns", header.chain[0].published_ns),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "role", role),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "state", state),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "pid", pid),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "obeys_stop", obeys_stop),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "reserved", reserved),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "issued_ns", issued_ns),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "activations", activations),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "published", published),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "used", used),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "replaced", replaced),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "invalid", invalid),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "stale", stale),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "duplicate", duplicate),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "reordered", reordered),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "foreign", foreign),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "missing", missing),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "undelivered", undelivered),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "timeouts", timeouts),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "looked_ns", looked_ns),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "taken", taken),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "taken_scans", taken_scans),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "answered", answered),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "answered_scans", answered_scans),
    SCANLOOP_VALUES("heartbeat", scanloop_heartbeat, "written", written),
    SCANLOOP_STRUCTS("heartbeat", scanloop_heartbeat, "inputs", "InputAccount", inputs),
    SCANLOOP_STRUCTS("heartbeat", scanloop_heartbeat, "inputs.writers", "Span", inputs[0].writers),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.writers.incarnation", inputs[0].writers[0].incarnation),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.writers.reserved", inputs[0].writers[0].reserved),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.writers.first", inputs[0].writers[0].first),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.writers.last", inputs[0].writers[0].last),
    SCANLOOP_STRUCT("heartbeat", scanloop_heartbeat, "inputs.hole", "Span", inputs[0].hole),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.hole.incarnation", inputs[0].hole.incarnation),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.hole.reserved", inputs[0].hole.reserved),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.hole.first", inputs[0].hole.first),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.hole.last", inputs[0].hole.last),
    SCANLOOP_STRUCT("heartbeat", scanloop_heartbeat, "inputs.twice", "Span", inputs[0].twice),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.twice.incarnation", inputs[0].twice.incarnation),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.twice.reserved", inputs[0].twice.reserved),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.twice.first", inputs[0].twice.first),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.twice.last", inputs[0].twice.last),
    SCANLOOP_STRUCT("heartbeat", scanloop_heartbeat, "inputs.late", "Span", inputs[0].late),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.late.incarnation", inputs[0].late.incarnation),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.late.reserved", inputs[0].late.reserved),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.late.first", inputs[0].late.first),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.late.last", inputs[0].late.last),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.arrived", inputs[0].arrived),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.used", inputs[0].used),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.replaced", inputs[0].replaced),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.overwritten", inputs[0].overwritten),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.stale", inputs[0].stale),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.foreign", inputs[0].foreign),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.invalid", inputs[0].invalid),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.duplicate", inputs[0].duplicate),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.reordered", inputs[0].reordered),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.missing", inputs[0].missing),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.open", inputs[0].open),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.open_sum", inputs[0].open_sum),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.waiting", inputs[0].waiting),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.waiting_sum", inputs[0].waiting_sum),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "inputs.unreadable", inputs[0].unreadable),
    SCANLOOP_STRUCTS("heartbeat", scanloop_heartbeat, "refused", "Refusal", refused),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "refused.count", refused[0].count),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "refused.scan_id", refused[0].scan_id),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "refused.value", refused[0].value),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "refused.incarnation", refused[0].incarnation),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "refused.rule", refused[0].rule),
    SCANLOOP_VALUES("heartbeat", scanloop_heartbeat, "refused.field", refused[0].field),
    SCANLOOP_STRUCT("heartbeat", scanloop_heartbeat, "device", "Device", device),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "device.state", device.state),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "device.reserved", device.reserved),
    SCANLOOP_VALUE("heartbeat", scanloop_heartbeat, "device.since_ns", device.since_ns),
    SCANLOOP_VALUES("heartbeat", scanloop_heartbeat, "device.reason", device.reason),
    SCANLOOP_SAMPLE("directive", scanloop_directive, "scanloop.Directive.v4"),
    SCANLOOP_STRUCT("directive", scanloop_directive, "header", "Header", header),
    SCANLOOP_VALUE("directive", scanloop_directive, "header.layout", header.layout),
    SCANLOOP_VALUE("directive", scanloop_directive, "header.incarnation", header.incarnation),
    SCANLOOP_VALUE("directive", scanloop_directive, "header.scan_id", header.scan_id),
    SCANLOOP_VALUE("directive", scanloop_directive, "header.sequence", header.sequence),
    SCANLOOP_VALUE("directive", scanloop_directive, "header.acquired_ns", header.acquired_ns),
    SCANLOOP_STRUCTS("directive", scanloop_directive, "header.chain", "StageStamps", header.chain),
    SCANLOOP_VALUE("directive", scanloop_directive, "header.chain.woken_ns", header.chain[0].woken_ns),
    SCANLOOP_VALUE("directive", scanloop_directive, "header.chain.taken_ns", header.chain[0].taken_ns),
    SCANLOOP_VALUE("directive", scanloop_directive, "header.chain.computed_ns", header.chain[0].computed_ns),
    SCANLOOP_VALUE("directive", scanloop_directive, "header.chain.published_ns", header.chain[0].published_ns),
    SCANLOOP_VALUE("directive", scanloop_directive, "phase", phase),
    SCANLOOP_VALUE("directive", scanloop_directive, "stop", stop),
    SCANLOOP_VALUE("directive", scanloop_directive, "granted_scan", granted_scan),
    SCANLOOP_VALUE("directive", scanloop_directive, "issued_ns", issued_ns),
    SCANLOOP_VALUE("directive", scanloop_directive, "orchestrator_pid", orchestrator_pid),
    SCANLOOP_STRUCTS("directive", scanloop_directive, "authority", "Authority", authority),
    SCANLOOP_VALUE("directive", scanloop_directive, "authority.incarnation", authority[0].incarnation),
    SCANLOOP_VALUE("directive", scanloop_directive, "authority.previous", authority[0].previous),
    SCANLOOP_VALUE("directive", scanloop_directive, "authority.from_scan", authority[0].from_scan),
    SCANLOOP_STRUCT("directive", scanloop_directive, "goal", "GivenGoal", goal),
    SCANLOOP_VALUE("directive", scanloop_directive, "goal.from_scan", goal.from_scan),
    SCANLOOP_VALUE("directive", scanloop_directive, "goal.index", goal.index),
    SCANLOOP_VALUE("directive", scanloop_directive, "goal.has_yaw", goal.has_yaw),
    SCANLOOP_VALUE("directive", scanloop_directive, "goal.x_m", goal.x_m),
    SCANLOOP_VALUE("directive", scanloop_directive, "goal.y_m", goal.y_m),
    SCANLOOP_VALUE("directive", scanloop_directive, "goal.tolerance_m", goal.tolerance_m),
    SCANLOOP_VALUE("directive", scanloop_directive, "goal.yaw_rad", goal.yaw_rad),
    SCANLOOP_VALUE("directive", scanloop_directive, "goal.yaw_tolerance_rad", goal.yaw_tolerance_rad),
    SCANLOOP_VALUE("directive", scanloop_directive, "goal.stay_s", goal.stay_s),
    SCANLOOP_VALUE("directive", scanloop_directive, "driven_by", driven_by),
    SCANLOOP_VALUE("directive", scanloop_directive, "reserved", reserved),
    SCANLOOP_STRUCT("directive", scanloop_directive, "person", "GivenControl", person),
    SCANLOOP_VALUE("directive", scanloop_directive, "person.number", person.number),
    SCANLOOP_VALUE("directive", scanloop_directive, "person.given_ns", person.given_ns),
    SCANLOOP_VALUE("directive", scanloop_directive, "person.velocity_mps", person.velocity_mps),
    SCANLOOP_VALUE("directive", scanloop_directive, "person.steering_rad", person.steering_rad),
    SCANLOOP_SAMPLE("checkpoint", scanloop_checkpoint, "scanloop.Checkpoint.v4"),
    SCANLOOP_STRUCT("checkpoint", scanloop_checkpoint, "header", "Header", header),
    SCANLOOP_VALUE("checkpoint", scanloop_checkpoint, "header.layout", header.layout),
    SCANLOOP_VALUE("checkpoint", scanloop_checkpoint, "header.incarnation", header.incarnation),
    SCANLOOP_VALUE("checkpoint", scanloop_checkpoint, "header.scan_id", header.scan_id),
    SCANLOOP_VALUE("checkpoint", scanloop_checkpoint, "header.sequence", header.sequence),
    SCANLOOP_VALUE("checkpoint", scanloop_checkpoint, "header.acquired_ns", header.acquired_ns),
    SCANLOOP_STRUCTS("checkpoint", scanloop_checkpoint, "header.chain", "StageStamps", header.chain),
    SCANLOOP_VALUE("checkpoint", scanloop_checkpoint, "header.chain.woken_ns", header.chain[0].woken_ns),
    SCANLOOP_VALUE("checkpoint", scanloop_checkpoint, "header.chain.taken_ns", header.chain[0].taken_ns),
    SCANLOOP_VALUE("checkpoint", scanloop_checkpoint, "header.chain.computed_ns", header.chain[0].computed_ns),
    SCANLOOP_VALUE("checkpoint", scanloop_checkpoint, "header.chain.published_ns", header.chain[0].published_ns),
    SCANLOOP_VALUE("checkpoint", scanloop_checkpoint, "role", role),
    SCANLOOP_VALUE("checkpoint", scanloop_checkpoint, "state_layout", state_layout),
    SCANLOOP_VALUE("checkpoint", scanloop_checkpoint, "length", length),
    SCANLOOP_VALUE("checkpoint", scanloop_checkpoint, "reserved", reserved),
    SCANLOOP_VALUE("checkpoint", scanloop_checkpoint, "issued_ns", issued_ns),
    SCANLOOP_VALUE("checkpoint", scanloop_checkpoint, "saved_ns", saved_ns),
    SCANLOOP_VALUES("checkpoint", scanloop_checkpoint, "bytes", bytes),
    SCANLOOP_SAMPLE("truth", scanloop_truth, "scanloop.Truth.v2"),
    SCANLOOP_STRUCT("truth", scanloop_truth, "header", "Header", header),
    SCANLOOP_VALUE("truth", scanloop_truth, "header.layout", header.layout),
    SCANLOOP_VALUE("truth", scanloop_truth, "header.incarnation", header.incarnation),
    SCANLOOP_VALUE("truth", scanloop_truth, "header.scan_id", header.scan_id),
    SCANLOOP_VALUE("truth", scanloop_truth, "header.sequence", header.sequence),
    SCANLOOP_VALUE("truth", scanloop_truth, "header.acquired_ns", header.acquired_ns),
    SCANLOOP_STRUCTS("truth", scanloop_truth, "header.chain", "StageStamps", header.chain),
    SCANLOOP_VALUE("truth", scanloop_truth, "header.chain.woken_ns", header.chain[0].woken_ns),
    SCANLOOP_VALUE("truth", scanloop_truth, "header.chain.taken_ns", header.chain[0].taken_ns),
    SCANLOOP_VALUE("truth", scanloop_truth, "header.chain.computed_ns", header.chain[0].computed_ns),
    SCANLOOP_VALUE("truth", scanloop_truth, "header.chain.published_ns", header.chain[0].published_ns),
    SCANLOOP_VALUE("truth", scanloop_truth, "time_s", time_s),
    SCANLOOP_VALUE("truth", scanloop_truth, "x_m", x_m),
    SCANLOOP_VALUE("truth", scanloop_truth, "y_m", y_m),
    SCANLOOP_VALUE("truth", scanloop_truth, "yaw_rad", yaw_rad),
    SCANLOOP_VALUE("truth", scanloop_truth, "sideslip_rad", sideslip_rad),
    SCANLOOP_VALUE("truth", scanloop_truth, "yaw_rate_radps", yaw_rate_radps),
    SCANLOOP_VALUE("truth", scanloop_truth, "speed_mps", speed_mps),
    SCANLOOP_VALUE("truth", scanloop_truth, "steering_rad", steering_rad),
    SCANLOOP_VALUE("truth", scanloop_truth, "clearance_m", clearance_m),
    SCANLOOP_VALUE("truth", scanloop_truth, "min_clearance_m", min_clearance_m),
    SCANLOOP_VALUE("truth", scanloop_truth, "path_length_m", path_length_m),
    SCANLOOP_VALUE("truth", scanloop_truth, "max_abs_lateral_m", max_abs_lateral_m),
    SCANLOOP_VALUE("truth", scanloop_truth, "goal_distance_m", goal_distance_m),
    SCANLOOP_VALUE("truth", scanloop_truth, "longest_blind_s", longest_blind_s),
    SCANLOOP_VALUE("truth", scanloop_truth, "actuation_age_s", actuation_age_s),
    SCANLOOP_VALUE("truth", scanloop_truth, "blocked", blocked),
    SCANLOOP_VALUE("truth", scanloop_truth, "collided", collided),
    SCANLOOP_VALUE("truth", scanloop_truth, "struck", struck),
    SCANLOOP_VALUE("truth", scanloop_truth, "dead_man", dead_man),
    SCANLOOP_VALUE("truth", scanloop_truth, "actuation_scan", actuation_scan),
    SCANLOOP_VALUE("truth", scanloop_truth, "refused", refused),
    SCANLOOP_VALUE("truth", scanloop_truth, "steps", steps),
    SCANLOOP_VALUE("truth", scanloop_truth, "reserved", reserved),
    SCANLOOP_SAMPLE("journal", scanloop_journal, "scanloop.Journal.v2"),
    SCANLOOP_STRUCT("journal", scanloop_journal, "header", "Header", header),
    SCANLOOP_VALUE("journal", scanloop_journal, "header.layout", header.layout),
    SCANLOOP_VALUE("journal", scanloop_journal, "header.incarnation", header.incarnation),
    SCANLOOP_VALUE("journal", scanloop_journal, "header.scan_id", header.scan_id),
    SCANLOOP_VALUE("journal", scanloop_journal, "header.sequence", header.sequence),
    SCANLOOP_VALUE("journal", scanloop_journal, "header.acquired_ns", header.acquired_ns),
    SCANLOOP_STRUCTS("journal", scanloop_journal, "header.chain", "StageStamps", header.chain),
    SCANLOOP_VALUE("journal", scanloop_journal, "header.chain.woken_ns", header.chain[0].woken_ns),
    SCANLOOP_VALUE("journal", scanloop_journal, "header.chain.taken_ns", header.chain[0].taken_ns),
    SCANLOOP_VALUE("journal", scanloop_journal, "header.chain.computed_ns", header.chain[0].computed_ns),
    SCANLOOP_VALUE("journal", scanloop_journal, "header.chain.published_ns", header.chain[0].published_ns),
    SCANLOOP_VALUE("journal", scanloop_journal, "role", role),
    SCANLOOP_VALUE("journal", scanloop_journal, "length", length),
    SCANLOOP_VALUE("journal", scanloop_journal, "output", output),
    SCANLOOP_STRUCTS("journal", scanloop_journal, "entries", "JournalEntry", entries),
    SCANLOOP_VALUE("journal", scanloop_journal, "entries.kind", entries[0].kind),
    SCANLOOP_VALUE("journal", scanloop_journal, "entries.topic", entries[0].topic),
    SCANLOOP_VALUE("journal", scanloop_journal, "entries.incarnation", entries[0].incarnation),
    SCANLOOP_VALUE("journal", scanloop_journal, "entries.value", entries[0].value),
    SCANLOOP_SAMPLE("clock", scanloop_clock_offset, "scanloop.ClockOffset.v2"),
    SCANLOOP_STRUCT("clock", scanloop_clock_offset, "header", "Header", header),
    SCANLOOP_VALUE("clock", scanloop_clock_offset, "header.layout", header.layout),
    SCANLOOP_VALUE("clock", scanloop_clock_offset, "header.incarnation", header.incarnation),
    SCANLOOP_VALUE("clock", scanloop_clock_offset, "header.scan_id", header.scan_id),
    SCANLOOP_VALUE("clock", scanloop_clock_offset, "header.sequence", header.sequence),
    SCANLOOP_VALUE("clock", scanloop_clock_offset, "header.acquired_ns", header.acquired_ns),
    SCANLOOP_STRUCTS("clock", scanloop_clock_offset, "header.chain", "StageStamps", header.chain),
    SCANLOOP_VALUE("clock", scanloop_clock_offset, "header.chain.woken_ns", header.chain[0].woken_ns),
    SCANLOOP_VALUE("clock", scanloop_clock_offset, "header.chain.taken_ns", header.chain[0].taken_ns),
    SCANLOOP_VALUE("clock", scanloop_clock_offset, "header.chain.computed_ns", header.chain[0].computed_ns),
    SCANLOOP_VALUE("clock", scanloop_clock_offset, "header.chain.published_ns", header.chain[0].published_ns),
    SCANLOOP_VALUES("clock", scanloop_clock_offset, "host", host),
    SCANLOOP_VALUE("clock", scanloop_clock_offset, "common_ns", common_ns),
    SCANLOOP_VALUE("clock", scanloop_clock_offset, "host_ns", host_ns),
    SCANLOOP_VALUE("clock", scanloop_clock_offset, "bound_ns", bound_ns),
};

/* The table and its length, the way `scanloop_open` takes them. */
#define SCANLOOP_LAYOUTS scanloop_layouts, (sizeof scanloop_layouts / sizeof scanloop_layouts[0])

#endif
