/* An obstacle detector in C. It groups the returns of the scanner into boxes, remembers the boxes, and gives each one
 * the ellipse (7.35) that the robot's centre stays outside of.
 *
 * It is simpler than the built-in one in three points. Boxes lie along the track, so a long body that is turned gets
 * more room than it needs. Bodies do not move: a moving body leaves boxes behind until three scans show ranges beyond
 * them, or for ten seconds. Walls are recognised by their position alone. Whether the scanner can be relied on is found
 * in health.h.
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "scanloop.h"

#include "health.h"

#define MAX_BODIES 24
#define GAP_M 0.25         /* returns that are further apart belong to different bodies */
#define NEAR_M 0.15        /* a box as near as this to a remembered one is the same body */
#define MIN_RETURNS 3           /* fewer returns than this may be noise */
#define SEEN_FREE 3        /* a body is forgotten after so many scans with ranges beyond its place */
#define REMEMBERED_S 10.0  /* a body is forgotten when nothing was seen of it for so long */
#define BEHIND_M 3.0       /* a body that is further behind is forgotten */
#define BODY_M 0.44        /* half the diagonal of the robot's body, plus 0.1 m */
#define PASSING_M 0.3      /* half its width while it passes a body at a small angle, plus 0.08 m */
#define ROOM 1.12          /* an ellipse that is wider by this factor holds the corners of a body without being long */
#define WIDE_M 2.0         /* a wider body is a wall */
#define STATE_KIND 0xb0d10002u /* number of this kind of state: `struct memory` */

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
    struct health health;
};

struct settings {
    double long_axis_m, ratio, depth_m, walls, band_m, beside_m, y_m[2];
};

static double setting(scanloop_process *process, const char *key, double otherwise) {
    scanloop_setting(process, key, &otherwise);
    return otherwise;
}

static struct settings read_settings(scanloop_process *process) {
    return (struct settings){
        .long_axis_m = setting(process, "long_axis_m", 1.2),
        .ratio = setting(process, "long_axis_ratio", 1.15),
        .depth_m = setting(process, "unseen_depth_m", 0.1),
        .walls = setting(process, "walls", 0.0),
        .band_m = setting(process, "wall_band_m", 0.12),
        .beside_m = setting(process, "beside_m", 0.6),
        .y_m = {setting(process, "wall_y_m.0", -1.5), setting(process, "wall_y_m.1", 1.5)},
    };
}

/* The lateral bounds between which a return can be an obstacle. */
static void bounds(const struct settings *settings, double y_m[2]) {
    double room = settings->walls > 0.5 ? -settings->band_m : settings->beside_m;
    y_m[0] = settings->y_m[0] - room;
    y_m[1] = settings->y_m[1] + room;
}

/* Computes the position of the return of a beam; 0 when there is no return, or when it cannot be an obstacle. */
static int locate(const struct view *view, const double y_m[2], int beam, double at[2]) {
    return place(view, beam, ERRORS[0], at) && at[1] > y_m[0] && at[1] < y_m[1];
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
static void detect(struct memory *memory, const struct view *view, const struct settings *settings) {
    struct box box = {{0.0, 0.0}, {0.0, 0.0}};
    double last[2] = {0.0, 0.0}, y_m[2];
    int returns = 0;
    bounds(settings, y_m);
    for (int beam = SCANLOOP_FIRST_ANALYSED_BEAM; beam <= SCANLOOP_LAST_ANALYSED_BEAM + 1; beam++) {
        double at[2] = {0.0, 0.0};
        int end = beam > SCANLOOP_LAST_ANALYSED_BEAM;
        int hit = !end && locate(view, y_m, beam, at);
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

/* Whether the beam to the middle of a remembered body shows something beyond it. Without a return it shows nothing. */
static int seen_free(const struct body *body, const struct view *view) {
    double at[2], distance;
    for (int axis = 0; axis < 2; axis++) {
        at[axis] = (body->box.low[axis] + body->box.high[axis]) / 2;
    }
    int beam = beam_to(view, at, ERRORS[0], &distance);
    double deep = hypot(body->box.high[0] - body->box.low[0], body->box.high[1] - body->box.low[1]) / 2;
    return beam >= 0 && range_of(view, beam) > distance + deep + 0.2;
}

/* Forgets bodies that are far behind, whose place was seen free, or that were seen only once or long ago. */
static void forget(struct memory *memory, const struct view *view) {
    uint32_t kept = 0;
    for (uint32_t index = 0; index < memory->count; index++) {
        struct body *body = &memory->bodies[index];
        if (body->unseen_s > 0.0 && seen_free(body, view)) {
            body->free_scans++;
        }
        int is_gone = body->free_scans >= SEEN_FREE || body->unseen_s > (body->sightings < 2 ? 0.35 : REMEMBERED_S);
        if (body->box.high[0] > view->x_m - BEHIND_M && !is_gone) {
            memory->bodies[kept++] = *body;
        }
    }
    memory->count = kept;
}

static scanloop_obstacle draw(const struct body *body, const struct settings *settings) {
    double length = body->box.high[0] - body->box.low[0], width = body->box.high[1] - body->box.low[1];
    double x = (body->box.low[0] + body->box.high[0]) / 2, y = (body->box.low[1] + body->box.high[1]) / 2;
    double b = ROOM * (width / 2 + PASSING_M);
    /* Past a wide body there is no way anyhow: its ellipse need not be long. */
    double a = width < WIDE_M ? fmax(settings->long_axis_m, settings->ratio * b) : settings->long_axis_m;
    /* A deep body needs a longer ellipse: its corners keep their distance too. */
    a = fmax(a, (length / 2 + BODY_M) / sqrt(1 - 1 / (ROOM * ROOM)));
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
    struct view view = view_of(scan, pose);
    double y_m[2];
    bounds(settings, y_m);
    if (scan->missing) {
        memory->health.blind_s += elapsed_s;
    } else if (check_scan(&memory->health, &view, y_m, elapsed_s)) {
        detect(memory, &view, settings);
        forget(memory, &view);
    }
    memset(described, 0, sizeof *described);
    scanloop_answer(&scan->header, &pose->header, &described->header);
    described->scanner = describe_health(&memory->health, scan, elapsed_s);
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
