/* The robot. Replace the three functions read_odometry, read_scan and write_wheels by those of yours.
 *
 * None of them may wait. As shipped they belong to a simulation with the faults of real devices: base and scanner have
 * one clock of their own, which restarts every 2 s, data arrive up to 3 ms late, and one sweep in 23 breaks off half-way. */
#ifndef DEVICE_H
#define DEVICE_H

#include <math.h>
#include <string.h>

#include "scanloop.h"

#define MS 1000000u              /* [ns] */
#define BASE_NS (20u * MS)       /* the base sends a state this often */
#define RESTART_NS (2000u * (uint64_t)MS) /* base and scanner restart this often */
#define LATE_NS (3u * MS)        /* data arrive this much late at most */
#define BROKEN 23u               /* one sweep in this many breaks off */
#define VELOCITY_FACTOR 1.4      /* the robot drives this much slower than it is told */
#define CURVATURE 5.405          /* of the path per steering angle [1/(m rad)] */

/* Pose from where the base started, left and counter-clockwise positive, and speed over ground. */
struct pose {
    double x_m, y_m, yaw_rad, speed_mps;
};

/* What the scanner has measured. */
struct sweep {
    uint64_t stamp_ns; /* when the front beam was taken */
    int beams;         /* how many beams have come; less than SCANLOOP_BEAMS when the sweep broke off */
    uint32_t ranges_mm[SCANLOOP_BEAMS];
};

struct device {
    uint64_t period_ns, now_ns, started_ns, sweeps, random;
    int drives;
    double velocity_mps, steering_rad;
    struct pose pose, origin, sent;
    uint64_t base_arrives_ns, base_stamp_ns, scan_arrives_ns; /* arrivals: 0 for nothing new */
    struct sweep sweep;
};

static void advance_to(struct device *device, uint64_t now_ns);

/* The newest state of the base that was not read before, with its stamp; 0 for none. */
static int read_odometry(struct device *device, uint64_t now_ns, uint64_t *stamp_ns, struct pose *pose) {
    advance_to(device, now_ns);
    if (device->base_arrives_ns == 0 || device->base_arrives_ns > now_ns) {
        return 0;
    }
    *stamp_ns = device->base_stamp_ns;
    *pose = device->sent;
    device->base_arrives_ns = 0;
    return 1;
}

/* The newest sweep that was not read before, complete or broken off; 0 for none. */
static int read_scan(struct device *device, uint64_t now_ns, struct sweep *sweep) {
    advance_to(device, now_ns);
    if (device->scan_arrives_ns == 0 || device->scan_arrives_ns > now_ns) {
        return 0;
    }
    *sweep = device->sweep;
    device->scan_arrives_ns = 0;
    return 1;
}

/* Drives with velocity and steering angle, or blocks the wheels. Called also when nothing changes. */
static void write_wheels(struct device *device, uint64_t now_ns, int drives, double velocity_mps, double steering_rad) {
    advance_to(device, now_ns);
    device->drives = drives;
    device->velocity_mps = velocity_mps;
    device->steering_rad = steering_rad;
}

/* Whether base and scanner stamp with the same clock; 0 where the scanner has one of its own. */
static int has_one_clock(const struct device *device) {
    (void)device;
    return 1;
}

/* Shortest time from the stamp of a state of the base to its arrival. */
static uint64_t base_delay_ns(const struct device *device) {
    (void)device;
    return 0;
}

/* Shortest time from the front beam to the arrival of a sweep: half of the sweep, plus its way. */
static uint64_t scan_delay_ns(const struct device *device) {
    return device->period_ns / 3;
}

static void open_device(struct device *device, uint64_t now_ns, uint64_t period_ns) {
    memset(device, 0, sizeof *device);
    device->period_ns = period_ns;
    device->now_ns = device->started_ns = now_ns;
    device->random = 1;
}

/* A number below `limit`. */
static uint64_t random_below(struct device *device, uint64_t limit) {
    device->random = device->random * 6364136223846793005u + 1442695040888963407u;
    return (device->random >> 33) % limit;
}

/* Moves the robot. Blocked wheels decelerate at 5 m/s^2, the drive changes speed by 2 m/s^2. */
static void roll(struct device *device, double dt_s) {
    struct pose *pose = &device->pose;
    double wanted = device->drives ? device->velocity_mps / VELOCITY_FACTOR : 0.0;
    double most = dt_s * (device->drives ? 2.0 : 5.0);
    pose->speed_mps += fmax(-most, fmin(most, wanted - pose->speed_mps));
    pose->yaw_rad += CURVATURE * device->steering_rad * pose->speed_mps * dt_s;
    pose->x_m += pose->speed_mps * cos(pose->yaw_rad) * dt_s;
    pose->y_m += pose->speed_mps * sin(pose->yaw_rad) * dt_s;
}

/* Distances to the walls of a hall, with an error of up to a centimetre. */
static void measure(struct device *device) {
    const struct pose *pose = &device->pose;
    for (int beam = 0; beam < SCANLOOP_BEAMS; beam++) {
        double yaw = pose->yaw_rad + SCANLOOP_FIRST_BEAM_YAW_RAD + beam * SCANLOOP_PITCH_RAD;
        double along = cos(yaw) > 0 ? (40.0 - pose->x_m) / cos(yaw) : (3.0 + pose->x_m) / -cos(yaw);
        double across = sin(yaw) > 0 ? (3.5 - pose->y_m) / sin(yaw) : (3.5 + pose->y_m) / -sin(yaw);
        double range_mm = 1e3 * fmin(along, across) + (double)random_below(device, 20) - 10.0;
        device->sweep.ranges_mm[beam] = range_mm < 5600.0 ? (uint32_t)range_mm : 0;
    }
}

/* The pose as a base reports it that started at `origin`. */
static struct pose seen_from(const struct pose *pose, const struct pose *origin) {
    double dx = pose->x_m - origin->x_m, dy = pose->y_m - origin->y_m;
    double c = cos(origin->yaw_rad), s = sin(origin->yaw_rad);
    return (struct pose){c * dx + s * dy, c * dy - s * dx, pose->yaw_rad - origin->yaw_rad, pose->speed_mps};
}

static void step_device(struct device *device) {
    roll(device, 1e-3);
    uint64_t run_ns = device->now_ns - device->started_ns, late_ns = random_below(device, LATE_NS);
    /* A clock of its own, 100 ppm fast, that begins again at zero. */
    uint64_t stamp_ns = run_ns % RESTART_NS + run_ns % RESTART_NS / 10000;
    if (run_ns % RESTART_NS == 0) {
        device->origin = device->pose;
    }
    if (run_ns % BASE_NS == 0) {
        device->sent = seen_from(&device->pose, &device->origin);
        device->base_stamp_ns = stamp_ns;
        device->base_arrives_ns = device->now_ns + late_ns;
    }
    if (run_ns / device->period_ns > device->sweeps) {
        device->sweeps = run_ns / device->period_ns;
        device->sweep.stamp_ns = stamp_ns;
        device->sweep.beams = device->sweeps % BROKEN == 0 ? SCANLOOP_BEAMS / 2 : SCANLOOP_BEAMS;
        measure(device);
        device->scan_arrives_ns = device->now_ns + device->period_ns / 3 + late_ns;
    }
}

static void advance_to(struct device *device, uint64_t now_ns) {
    while (device->now_ns + MS <= now_ns) {
        device->now_ns += MS;
        step_device(device);
    }
}

#endif
