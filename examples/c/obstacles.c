/* An obstacle detector in C. It groups the returns of the scanner into boxes, remembers the boxes, and gives each one
 * the ellipse (7.35) that the robot's centre stays outside of.
 *
 * It is simpler than the built-in one in three points. Boxes lie along the track, so a long body that is turned gets
 * more room than it needs. Bodies do not move: a moving body leaves boxes behind until three scans see their places
 * free. Walls are recognised by their position alone.
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "scanloop.h"

#define MAX_BODIES 24
#define MAX_RANGE_M 5.75   /* a longer range is no return */
#define GAP_M 0.25         /* returns that are further apart belong to different bodies */
#define NEAR_M 0.15        /* a box as near as this to a remembered one is the same body */
#define MIN_RETURNS 3           /* fewer returns than this may be noise */
#define SEEN_FREE 3        /* a body is forgotten after so many scans that see its place free */
#define BEHIND_M 3.0       /* a body that is further behind is forgotten */
#define BODY_M 0.44        /* half the diagonal of the robot's body, plus 0.1 m */
#define STATE_KIND 0xb0d10001u /* number of this kind of state: `struct memory` */

/* A box along the track, in metres. */
struct box {
    double low[2], high[2];
};

struct body {
    struct box box;
    double unseen_s;
    uint64_t sightings;
    uint32_t number;
    uint32_t free_scans;
};

/* What the next scan depends on. It is saved after each scan. */
struct memory {
    uint64_t acquired_ns;
    uint32_t count;
    uint32_t last_number;
    struct body bodies[MAX_BODIES];
};

struct settings {
    double theta_m, long_axis_m, ratio, depth_m, walls, band_m, beside_m, y_m[2];
};

static double setting(scanloop_process *process, const char *key, double otherwise) {
    scanloop_setting(process, key, &otherwise);
    return otherwise;
}

static struct settings read_settings(scanloop_process *process) {
    return (struct settings){
        .theta_m = setting(process, "safety_distance_m", 0.2),
        .long_axis_m = setting(process, "long_axis_m", 1.2),
        .ratio = setting(process, "long_axis_ratio", 1.15),
        .depth_m = setting(process, "unseen_depth_m", 0.1),
        .walls = setting(process, "walls", 0.0),
        .band_m = setting(process, "wall_band_m", 0.12),
        .beside_m = setting(process, "beside_m", 0.6),
        .y_m = {setting(process, "wall_y_m.0", -1.5), setting(process, "wall_y_m.1", 1.5)},
    };
}

/* Computes the position of the return of a beam; 0 when there is no return, or when it cannot be an obstacle. */
static int locate(const scanloop_scan *scan, const scanloop_pose *pose, const struct settings *settings, int beam,
                 double at[2]) {
    double range = scan->ranges_mm[beam] * 1e-3;
    if (scan->ranges_mm[beam] < SCANLOOP_MIN_RANGE_MM || range > MAX_RANGE_M) {
        return 0;
    }
    /* The robot moves during the sweep, so each beam starts where the robot was at its time. */
    double since_s = (double)(beam - SCANLOOP_FRONT_BEAM) / SCANLOOP_BEAMS * (double)scan->sweep_ns * 1e-9;
    double course = pose->yaw_rad + pose->sideslip_rad;
    double yaw = pose->yaw_rad + pose->yaw_rate_radps * since_s;
    double angle = yaw + SCANLOOP_FIRST_BEAM_YAW_RAD + beam * SCANLOOP_PITCH_RAD;
    at[0] = pose->x_m + pose->speed_mps * since_s * cos(course) + range * cos(angle);
    at[1] = pose->y_m + pose->speed_mps * since_s * sin(course) + range * sin(angle);
    double room = settings->walls > 0.5 ? -settings->band_m : settings->beside_m;
    return at[1] > settings->y_m[0] - room && at[1] < settings->y_m[1] + room;
}

static int near(const struct box *one, const struct box *other) {
    for (int axis = 0; axis < 2; axis++) {
        if (one->low[axis] > other->high[axis] + NEAR_M || other->low[axis] > one->high[axis] + NEAR_M) {
            return 0;
        }
    }
    return 1;
}

static void grow(struct box *box, const struct box *more) {
    for (int axis = 0; axis < 2; axis++) {
        box->low[axis] = fmin(box->low[axis], more->low[axis]);
        box->high[axis] = fmax(box->high[axis], more->high[axis]);
    }
}

/* Adds the box of one scan to the remembered body, or remembers a new one. */
static void remember(struct memory *memory, const struct box *box) {
    for (uint32_t index = 0; index < memory->count; index++) {
        struct body *body = &memory->bodies[index];
        if (near(&body->box, box)) {
            grow(&body->box, box);
            body->sightings += body->unseen_s > 0.0;
            body->unseen_s = 0.0;
            body->free_scans = 0;
            return;
        }
    }
    if (memory->count < MAX_BODIES) {
        memory->last_number++;
        memory->bodies[memory->count++] = (struct body){.box = *box, .sightings = 1, .number = memory->last_number};
    }
}

/* Groups the returns of a scan into boxes and remembers them. */
static void detect(struct memory *memory, const scanloop_scan *scan, const scanloop_pose *pose,
                 const struct settings *settings) {
    struct box box = {{0.0, 0.0}, {0.0, 0.0}};
    double last[2] = {0.0, 0.0};
    int returns = 0;
    for (int beam = SCANLOOP_FIRST_ANALYSED_BEAM; beam <= SCANLOOP_LAST_ANALYSED_BEAM + 1; beam++) {
        double at[2] = {0.0, 0.0};
        int end = beam > SCANLOOP_LAST_ANALYSED_BEAM;
        int hit = !end && locate(scan, pose, settings, beam, at);
        if (returns > 0 && (end || (hit && hypot(at[0] - last[0], at[1] - last[1]) > GAP_M))) {
            if (returns >= MIN_RETURNS) {
                /* Only the front is seen: the body has at least this depth. */
                box.high[0] = fmax(box.high[0], box.low[0] + settings->depth_m);
                remember(memory, &box);
            }
            returns = 0;
        }
        if (hit) {
            struct box point = {{at[0], at[1]}, {at[0], at[1]}};
            if (returns++ == 0) {
                box = point;
            }
            grow(&box, &point);
            memcpy(last, at, sizeof last);
        }
    }
}

/* Whether a beam passes through the middle of a remembered body. */
static int seen_free(const struct body *body, const scanloop_scan *scan, const scanloop_pose *pose) {
    double x = (body->box.low[0] + body->box.high[0]) / 2 - pose->x_m;
    double y = (body->box.low[1] + body->box.high[1]) / 2 - pose->y_m;
    double angle = remainder(atan2(y, x) - pose->yaw_rad, 2 * acos(-1.0));
    int beam = (int)lround((angle - SCANLOOP_FIRST_BEAM_YAW_RAD) / SCANLOOP_PITCH_RAD);
    if (beam < SCANLOOP_FIRST_ANALYSED_BEAM || beam > SCANLOOP_LAST_ANALYSED_BEAM || hypot(x, y) > MAX_RANGE_M - 1.0) {
        return 0;
    }
    double deep = hypot(body->box.high[0] - body->box.low[0], body->box.high[1] - body->box.low[1]) / 2;
    double range = scan->ranges_mm[beam] * 1e-3;
    return scan->ranges_mm[beam] < SCANLOOP_MIN_RANGE_MM || range > hypot(x, y) + deep + 0.2;
}

/* Forgets bodies that are far behind, whose place was seen free, or that were seen only once. */
static void forget(struct memory *memory, const scanloop_scan *scan, const scanloop_pose *pose) {
    uint32_t kept = 0;
    for (uint32_t index = 0; index < memory->count; index++) {
        struct body *body = &memory->bodies[index];
        if (body->unseen_s > 0.0 && seen_free(body, scan, pose)) {
            body->free_scans++;
        }
        int speckle = body->sightings < 2 && body->unseen_s > 0.35;
        if (body->box.high[0] > pose->x_m - BEHIND_M && body->free_scans < SEEN_FREE && !speckle) {
            memory->bodies[kept++] = *body;
        }
    }
    memory->count = kept;
}

static scanloop_obstacle draw(const struct body *body, const struct settings *settings) {
    double length = body->box.high[0] - body->box.low[0], width = body->box.high[1] - body->box.low[1];
    double x = (body->box.low[0] + body->box.high[0]) / 2, y = (body->box.low[1] + body->box.high[1]) / 2;
    double b = width + 2 * settings->theta_m;
    double a = fmax(settings->long_axis_m, settings->ratio * b);
    /* A deep body needs a longer ellipse: its corners keep their distance too. */
    double height = fmin((width / 2 + 0.3) / b, 0.95);
    a = fmax(a, (length / 2 + BODY_M) / sqrt(1 - height * height));
    return (scanloop_obstacle){
        .id = body->number, .body = body->number,
        .x_m = x, .y_m = y, .a_m = fmin(a, 100.0), .b_m = fmin(b, 100.0),
        .velocity_covariance = {1e-4, 0.0, 1e-4},
        .box_x_m = x, .box_y_m = y, .box_length_m = length, .box_width_m = width,
        .unseen_s = body->unseen_s, .sightings = body->sightings,
    };
}

static int is_after(const scanloop_obstacle *one, const scanloop_obstacle *other, const scanloop_pose *pose) {
    int behind = one->x_m < pose->x_m, other_behind = other->x_m < pose->x_m;
    double distance = hypot(one->x_m - pose->x_m, one->y_m - pose->y_m);
    double other_distance = hypot(other->x_m - pose->x_m, other->y_m - pose->y_m);
    return behind != other_behind ? behind : distance > other_distance;
}

/* Fills the sample, nearest body ahead first. */
static void describe(const struct memory *memory, const scanloop_pose *pose, const struct settings *settings,
                     scanloop_obstacles *described) {
    for (uint32_t index = 0; index < memory->count; index++) {
        if (memory->bodies[index].sightings < 2) {
            continue;
        }
        if (described->count == SCANLOOP_MAX_OBSTACLES) {
            described->overflow++;
            continue;
        }
        scanloop_obstacle drawn = draw(&memory->bodies[index], settings);
        uint32_t slot = described->count++;
        while (slot > 0 && is_after(&described->items[slot - 1], &drawn, pose)) {
            described->items[slot] = described->items[slot - 1];
            slot--;
        }
        described->items[slot] = drawn;
    }
}

static void step(struct memory *memory, const struct settings *settings, const scanloop_scan *scan,
                 const scanloop_pose *pose, scanloop_obstacles *described) {
    uint64_t now = scan->header.acquired_ns;
    double elapsed_s = now > memory->acquired_ns && memory->acquired_ns > 0 ? (now - memory->acquired_ns) * 1e-9 : 0.0;
    memory->acquired_ns = now;
    for (uint32_t index = 0; index < memory->count; index++) {
        memory->bodies[index].unseen_s += fmax(elapsed_s, 1e-9);
    }
    detect(memory, scan, pose, settings);
    forget(memory, scan, pose);
    memset(described, 0, sizeof *described);
    scanloop_answer(&scan->header, &pose->header, &described->header);
    describe(memory, pose, settings, described);
}

/* Runs until the process is to end: SCANLOOP_NO, or an error. */
static int run(scanloop_process *process) {
    struct settings settings = read_settings(process);
    static struct memory memory;
    int handover = scanloop_resume(process, STATE_KIND, &memory, sizeof memory);
    if (handover < 0) {
        return handover;
    }
    if (handover == SCANLOOP_LOST) {
        scanloop_log(SCANLOOP_ERROR, "no fresh state to resume from: no obstacles will be published");
    }
    int result = scanloop_start(process);
    while (result == SCANLOOP_YES && (result = scanloop_wait(process, 0)) == SCANLOOP_YES) {
        const void *scan, *pose;
        while (result == SCANLOOP_YES && scanloop_join(process, &scan, &pose) == SCANLOOP_YES) {
            if (handover == SCANLOOP_LOST) {
                continue;
            }
            scanloop_obstacles described;
            step(&memory, &settings, scan, pose, &described);
            result = scanloop_publish(process, SCANLOOP_TOPIC_OBSTACLES, &described, sizeof described);
            if (result == SCANLOOP_YES) {
                result = scanloop_save(process, &described.header, STATE_KIND, &memory, sizeof memory);
            }
        }
    }
    return result;
}

int main(void) {
    scanloop_process *process;
    int result = scanloop_open(SCANLOOP_ROLE_OBSTACLES, SCANLOOP_LAYOUTS, &process);
    if (result == SCANLOOP_YES) {
        result = run(process);
        scanloop_close(process);
    }
    if (result < 0) {
        fprintf(stderr, "%s\n", scanloop_last_error());
        return result == SCANLOOP_OTHER_LAYOUT || result == SCANLOOP_NOT_IN_A_SYSTEM ? 2 : 1;
    }
    return 0;
}
