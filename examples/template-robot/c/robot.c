/* A driver of your own robot in C, ready to be copied and changed.
 *
 * It publishes a scan and the odometry at its front beam once per sweep, and writes velocity and steering angle to the
 * wheels. Replace the three functions of device.h; this file is what every driver must do: stamps on CLOCK_MONOTONIC,
 * whole scans only, and wheels that stop by themselves. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "scanloop.h"

#include "device.h"

#define POLL_NS (5u * MS)    /* the device is polled this often, also when no actuation comes */
#define END_NS (800u * MS)   /* a process that is asked to end is killed after one second */
#define VELOCITY_MAX_MPS 2.0 /* what the actuator may send; anything else is not obeyed */
#define STEERING_MAX_RAD 0.12
#define SLACK 1e-9           /* rounding of what was limited to these values */
#define REST_MPS 1e-3        /* below this speed the wheels rest */
#define TURN 6.283185307179586
#define MAX_MISSING 3              /* periods without data, or broken sweeps in a row, that are a fault */
#define MAX_STATES 256             /* states of the base, more than it sends in two scan periods */
#define MAX_DELAY_NS (1000u * MS)  /* no message is delayed by more: an older stamp is one of a device that was restarted */
#define WINDOW_NS (5000u * MS)     /* when all messages of this time are late by JUMP_NS, the device's clock stood still */
#define JUMP_NS (20 * (int64_t)MS)

/* The clock of one device. A restart of the device starts the mapping anew. */
struct device_clock {
    uint64_t delay_ns; /* shortest time from a stamp to the arrival of its data */
    int is_known;
    int64_t offset_ns; /* smallest arrival minus stamp: that with the smallest delay */
    uint64_t stamp_ns, arrived_ns;
    uint64_t window_ns; /* start of a window, and its smallest arrival minus stamp */
    int64_t least_ns;
    unsigned restarts, overtaken;
};

struct state {
    int64_t at_ns; /* its stamp where base and scanner have one clock, else its time */
    struct pose pose;
};

struct driver {
    scanloop_process *process;
    struct device device;
    struct device_clock scanner_clock, base_clock;
    struct state states[MAX_STATES]; /* a ring, `count` were added */
    unsigned count;
    int64_t behind_ns;  /* from the stamp of the newest one to its time */
    struct pose origin; /* of the base since its last restart */
    int waits;          /* a sweep that waits for the odometry after it */
    uint64_t front_ns, at_ns; /* its front beam on CLOCK_MONOTONIC, and as the time of a state */
    struct sweep sweep;
    uint64_t base_ns, scanner_ns; /* when they sent data last; 0 before the first */
    unsigned broken;              /* sweeps that broke off since the last whole one */
    scanloop_odometry last;
    int drives;
    uint64_t told_ns, period_ns;
    double speed_mps;
};

static double wrap(double angle_rad) {
    double rest = remainder(angle_rad, TURN);
    return rest <= -TURN / 2 ? rest + TURN : rest;
}

static int64_t smaller(int64_t one, int64_t other) {
    return one < other ? one : other;
}

/* Whether a stamp before the newest one is of a message that was overtaken. A restarted device has lost most of its count.
 * Nothing newer comes from one whose clock was set back. */
static int is_overtaken(const struct device_clock *clock, uint64_t stamp_ns, uint64_t arrived_ns) {
    uint64_t since_ns = arrived_ns - clock->arrived_ns, delay_ns = since_ns + clock->stamp_ns - stamp_ns;
    return delay_ns <= MAX_DELAY_NS || (stamp_ns >= clock->stamp_ns / 2 && since_ns <= MAX_DELAY_NS);
}

/* Smallest arrival minus stamp, without the delay that the data have at least. */
static int64_t offset_of(const struct device_clock *clock) {
    return clock->offset_ns - (int64_t)clock->delay_ns;
}

/* The time of a stamp on CLOCK_MONOTONIC; 0 for a message that was overtaken by others, whose data are old. `beside`, if
 * not null, maps other data of the same clock: the smaller delay of both counts. */
static uint64_t map_stamp(struct device_clock *clock, uint64_t stamp_ns, uint64_t arrived_ns, const struct device_clock *beside) {
    int64_t found_ns = (int64_t)(arrived_ns - stamp_ns);
    if (clock->is_known && stamp_ns < clock->stamp_ns) {
        if (is_overtaken(clock, stamp_ns, arrived_ns)) {
            clock->overtaken++;
            return 0;
        }
        clock->restarts++;
        clock->is_known = 0;
    }
    if (!clock->is_known) {
        clock->is_known = 1;
        clock->offset_ns = clock->least_ns = found_ns;
        clock->window_ns = clock->arrived_ns = arrived_ns;
    }
    /* 200 ppm: more than two crystals drift apart. */
    clock->offset_ns = smaller(found_ns, clock->offset_ns + (int64_t)((arrived_ns - clock->arrived_ns) / 5000));
    clock->least_ns = smaller(found_ns, clock->least_ns);
    if (arrived_ns - clock->window_ns > WINDOW_NS) {
        if (clock->least_ns > clock->offset_ns + JUMP_NS) {
            clock->offset_ns = clock->least_ns;
        }
        clock->window_ns = arrived_ns;
        clock->least_ns = found_ns;
    }
    clock->stamp_ns = stamp_ns;
    clock->arrived_ns = arrived_ns;
    int64_t offset_ns = offset_of(clock);
    /* Further apart they are only while one of both knows of a restart. */
    if (beside != NULL && beside->is_known && arrived_ns - beside->arrived_ns < MAX_DELAY_NS &&
        llabs(offset_of(beside) - offset_ns) < (int64_t)MAX_DELAY_NS) {
        offset_ns = smaller(offset_ns, offset_of(beside));
    }
    return stamp_ns + (uint64_t)offset_ns;
}

/* A pose that is given from `origin`, in the frame of `origin`. */
static struct pose from(const struct pose *origin, const struct pose *pose) {
    double c = cos(origin->yaw_rad), s = sin(origin->yaw_rad);
    return (struct pose){origin->x_m + c * pose->x_m - s * pose->y_m, origin->y_m + s * pose->x_m + c * pose->y_m,
                         wrap(origin->yaw_rad + pose->yaw_rad), pose->speed_mps};
}

/* Adds a state, by its stamp where base and scanner have one clock, else by its time. After a restart the base counts from
 * zero again; the robot has not moved by that. */
static void add_state(struct driver *driver, uint64_t at_ns, uint64_t time_ns, const struct pose *reported, int restarted) {
    int64_t behind_ns = (int64_t)(time_ns - at_ns);
    const struct state *last = driver->count > 0 ? &driver->states[(driver->count - 1) % MAX_STATES] : NULL;
    if (restarted && last != NULL) {
        struct pose turn = {0.0, 0.0, last->pose.yaw_rad - reported->yaw_rad, 0.0};
        struct pose moved = from(&turn, reported);
        driver->origin =
            (struct pose){last->pose.x_m - moved.x_m, last->pose.y_m - moved.y_m, turn.yaw_rad, 0.0};
        /* A clock that began again has another stamp for the states before. */
        for (unsigned index = 0; index < MAX_STATES; index++) {
            driver->states[index].at_ns += driver->behind_ns - behind_ns;
        }
    }
    driver->behind_ns = behind_ns;
    if (last == NULL || (int64_t)at_ns > last->at_ns) {
        driver->states[driver->count++ % MAX_STATES] = (struct state){(int64_t)at_ns, from(&driver->origin, reported)};
    }
}

/* The pose at a time between two states; 0 when there are none, or when they are too far apart. */
static int pose_at(const struct driver *driver, int64_t at_ns, struct pose *pose) {
    for (unsigned index = driver->count; index > 1 && index + MAX_STATES > driver->count + 1; index--) {
        const struct state *late = &driver->states[(index - 1) % MAX_STATES];
        const struct state *early = &driver->states[(index - 2) % MAX_STATES];
        if (at_ns > late->at_ns) {
            return 0;
        }
        if (at_ns > early->at_ns) {
            int64_t apart_ns = late->at_ns - early->at_ns;
            double share = (double)(at_ns - early->at_ns) / (double)apart_ns;
            const struct pose *one = &early->pose, *other = &late->pose;
            pose->x_m = one->x_m + share * (other->x_m - one->x_m);
            pose->y_m = one->y_m + share * (other->y_m - one->y_m);
            pose->yaw_rad = wrap(one->yaw_rad + share * wrap(other->yaw_rad - one->yaw_rad));
            pose->speed_mps = one->speed_mps + share * (other->speed_mps - one->speed_mps);
            return apart_ns <= (int64_t)driver->period_ns * 3 / 2;
        }
    }
    return 0;
}

static void block(struct driver *driver, uint64_t now_ns) {
    write_wheels(&driver->device, now_ns, 0, 0.0, 0.0);
    driver->drives = 0;
}

/* Whether a velocity and an angle can be meant; NaN is in no range. */
static int is_possible(const scanloop_actuation *actuation) {
    return fabs(actuation->sent_velocity_mps) <= VELOCITY_MAX_MPS + SLACK &&
           fabs(actuation->sent_steering_rad) <= STEERING_MAX_RAD + SLACK;
}

/* Writes what the actuator commands. The dead man: without it for two periods the wheels are blocked. */
static int obey(struct driver *driver, const scanloop_directive *directive) {
    uint64_t now_ns = scanloop_now_ns(driver->process);
    const void *sample;
    int result;
    while ((result = scanloop_read(driver->process, SCANLOOP_TOPIC_ACTUATION, &sample)) == SCANLOOP_YES) {
        const scanloop_actuation *actuation = sample;
        if (actuation->kind == SCANLOOP_ACTUATION_KIND_BLOCK) {
            block(driver, now_ns);
        } else if (actuation->kind == SCANLOOP_ACTUATION_KIND_DRIVE && is_possible(actuation)) {
            write_wheels(&driver->device, now_ns, 1, actuation->sent_velocity_mps, actuation->sent_steering_rad);
            driver->drives = 1;
            driver->told_ns = now_ns;
        }
    }
    if (directive->stop != 0 || (driver->drives && now_ns - driver->told_ns >= 2 * driver->period_ns)) {
        block(driver, now_ns);
    }
    return result;
}

/* Reports to `scanloop status` what base and scanner do. */
static void report_devices(const struct driver *driver) {
    uint64_t now_ns = scanloop_now_ns(driver->process), limit_ns = MAX_MISSING * driver->period_ns;
    uint32_t state = SCANLOOP_DEVICE_STATE_FAULT;
    const char *reason = "";
    char overtaken[64] = "";
    if (driver->base_ns == 0 || driver->scanner_ns == 0) {
        state = SCANLOOP_DEVICE_STATE_CONNECTING;
        reason = driver->base_ns == 0 ? "base: no data yet" : "scanner: no sweep yet";
    } else if (now_ns > driver->base_ns + limit_ns) {
        reason = "base: sends no data";
    } else if (now_ns > driver->scanner_ns + limit_ns) {
        reason = "scanner: sends no sweeps";
    } else if (driver->broken >= MAX_MISSING) {
        reason = "scanner: all sweeps break off";
    } else {
        unsigned count = driver->base_clock.overtaken + driver->scanner_clock.overtaken;
        if (count > 0) {
            snprintf(overtaken, sizeof overtaken, "%u messages were overtaken by others", count);
        }
        reason = overtaken;
        state = SCANLOOP_DEVICE_STATE_RUNNING;
    }
    scanloop_report_device(driver->process, state, reason);
}

/* Reports to `scanloop stop` what the wheels do. */
static void report(const struct driver *driver) {
    uint32_t standing = fabs(driver->speed_mps) > REST_MPS ? SCANLOOP_BLOCKED : SCANLOOP_RESTING;
    scanloop_report_wheels(driver->process, driver->drives ? SCANLOOP_TURNING : standing);
    report_devices(driver);
}

/* Whether a front beam is after the one before; logs a gap. */
static int is_next(const struct driver *driver, uint64_t front_ns) {
    uint64_t last_ns = driver->last.header.acquired_ns;
    if (last_ns > 0 && front_ns > last_ns + driver->period_ns * 3 / 2) {
        scanloop_log(SCANLOOP_WARN, "a gap between two sweeps");
    }
    return last_ns == 0 || front_ns >= last_ns + driver->period_ns / 4;
}

/* Reads what base and scanner have measured, and maps their stamps to CLOCK_MONOTONIC. */
static void read_device(struct driver *driver) {
    uint64_t now_ns = scanloop_now_ns(driver->process), stamp_ns;
    int one_clock = has_one_clock(&driver->device);
    struct pose pose;
    if (read_odometry(&driver->device, now_ns, &stamp_ns, &pose)) {
        unsigned restarts = driver->base_clock.restarts;
        uint64_t time_ns = map_stamp(&driver->base_clock, stamp_ns, now_ns, NULL);
        if (time_ns != 0) {
            add_state(driver, one_clock ? stamp_ns : time_ns, time_ns, &pose, driver->base_clock.restarts > restarts);
            driver->speed_mps = pose.speed_mps;
        }
        driver->base_ns = now_ns;
    }
    struct sweep sweep;
    if (read_scan(&driver->device, now_ns, &sweep)) {
        const struct device_clock *beside = one_clock ? &driver->base_clock : NULL;
        uint64_t front_ns = map_stamp(&driver->scanner_clock, sweep.stamp_ns, now_ns, beside);
        if (front_ns != 0) {
            driver->sweep = sweep;
            driver->front_ns = front_ns;
            driver->at_ns = one_clock ? sweep.stamp_ns : front_ns;
            driver->waits = is_next(driver, driver->front_ns);
        }
        driver->scanner_ns = now_ns;
        driver->broken = sweep.beams == SCANLOOP_BEAMS ? 0 : driver->broken + 1;
    }
}

/* The odometry, with what has changed since the sample before. */
static void set_odometry(scanloop_odometry *odometry, const scanloop_header *header, const struct pose *pose) {
    scanloop_odometry before = *odometry;
    *odometry = (scanloop_odometry){.header = *header, .x_m = pose->x_m, .y_m = pose->y_m, .yaw_rad = pose->yaw_rad,
                                    .speed_mps = pose->speed_mps};
    if (before.header.scan_id > 0) {
        odometry->dx_m = pose->x_m - before.x_m;
        odometry->dy_m = pose->y_m - before.y_m;
        odometry->dyaw_rad = wrap(pose->yaw_rad - before.yaw_rad);
        odometry->dt_s = (double)(header->acquired_ns - before.header.acquired_ns) * 1e-9;
    }
}

/* Publishes the sweep that waits, when the odometry at its front beam is known. */
static int publish(struct driver *driver, const scanloop_directive *directive) {
    struct pose pose;
    if (!driver->waits) {
        return SCANLOOP_YES;
    }
    int is_old = scanloop_now_ns(driver->process) > driver->front_ns + 2 * driver->period_ns;
    if (is_old || directive->phase == SCANLOOP_PHASE_STOPPING) {
        driver->waits = 0;
        return SCANLOOP_YES;
    }
    if (!pose_at(driver, (int64_t)driver->at_ns, &pose)) {
        return SCANLOOP_YES;
    }
    driver->waits = 0;
    scanloop_header header = {.scan_id = driver->last.header.scan_id + 1, .acquired_ns = driver->front_ns};
    scanloop_scan scan = {
        .header = header, .sweep_ns = driver->period_ns * 2 / 3, .period_ns = driver->period_ns,
        .first_rad = SCANLOOP_FIRST_BEAM_YAW_RAD, .increment_rad = SCANLOOP_PITCH_RAD, .beams = SCANLOOP_BEAMS,
    };
    /* A sweep that broke off is marked as missing, with zeros only. */
    scan.missing = driver->sweep.beams != SCANLOOP_BEAMS;
    if (!scan.missing) {
        memcpy(scan.ranges_mm, driver->sweep.ranges_mm, sizeof driver->sweep.ranges_mm);
    }
    set_odometry(&driver->last, &header, &pose);
    int result = scanloop_begin(driver->process);
    if (result >= 0) {
        result = scanloop_publish(driver->process, SCANLOOP_TOPIC_SCAN, &scan, sizeof scan);
    }
    return result < 0 ? result
                      : scanloop_publish(driver->process, SCANLOOP_TOPIC_ODOMETRY, &driver->last, sizeof driver->last);
}

/* All that is due: wheels first, then what was measured. */
static int turn(struct driver *driver) {
    scanloop_directive directive;
    int result = scanloop_status(driver->process, NULL, &directive);
    if (result < 0 || (result = obey(driver, &directive)) < 0) {
        return result;
    }
    read_device(driver);
    report(driver);
    return publish(driver, &directive);
}

/* Blocks the wheels, and waits for as long as an end may take until the robot rests. */
static void come_to_rest(struct driver *driver) {
    uint64_t now_ns = scanloop_now_ns(driver->process), until_ns = now_ns + END_NS;
    do {
        block(driver, now_ns);
        read_device(driver);
        report(driver);
        scanloop_wait(driver->process, now_ns + POLL_NS);
        now_ns = scanloop_now_ns(driver->process);
    } while (fabs(driver->speed_mps) > REST_MPS && now_ns < until_ns);
    report(driver);
}

static int wait_for_poll(struct driver *driver) {
    return scanloop_wait(driver->process, scanloop_now_ns(driver->process) + POLL_NS);
}

int main(void) {
    static struct driver driver;
    int result = scanloop_open(SCANLOOP_ROLE_ROBOT, SCANLOOP_LAYOUTS, &driver.process);
    if (result == SCANLOOP_YES) {
        driver.period_ns = scanloop_period_ns(driver.process);
        open_device(&driver.device, scanloop_now_ns(driver.process), driver.period_ns);
        driver.base_clock.delay_ns = base_delay_ns(&driver.device);
        driver.scanner_clock.delay_ns = scan_delay_ns(&driver.device);
        scanloop_report_wheels(driver.process, SCANLOOP_RESTING);
        result = scanloop_start(driver.process);
        while (result == SCANLOOP_YES && (result = wait_for_poll(&driver)) == SCANLOOP_YES) {
            if ((result = turn(&driver)) == SCANLOOP_NO) {
                result = SCANLOOP_YES;
            }
        }
        come_to_rest(&driver);
        scanloop_close(driver.process);
    }
    if (result < 0) {
        fprintf(stderr, "%s\n", scanloop_last_error());
        return result == SCANLOOP_OTHER_LAYOUT || result == SCANLOOP_NOT_IN_A_SYSTEM ? 2 : 1;
    }
    return 0;
}
