/* Whether the scanner can be relied on. Part of obstacles.c.
 *
 * A missing return is no proof of free space. So each scan is compared with the one before and with one from half a
 * metre before, whose returns the motion of the robot predicts.
 *
 * It is simpler and stricter than the built-in one. Surroundings must return something, so in the open it is always
 * blind. Wrong ranges are found by trying some factors and mounting angles: when one of them explains the scans better
 * than none does, the scanner contradicts the motion. A narrow sector ahead that was covered while nothing was in it is
 * not found.
 */
#include <math.h>
#include <string.h>

#include "scanloop_types.h"

#define MAX_RANGE_M 5.75 /* a longer range is no return */
#define PREDICTED_M 5.0  /* a return that is expected farther away need not come */
#define MIN_SHARE 0.04   /* share of all beams that return something in any surroundings */
#define MOVED_M 0.003    /* a robot that has moved less rests */
#define KEYFRAME_M 0.5   /* way after which another scan is kept for comparison */
#define RIGHT_M 0.2      /* a return this near to its predicted range is right */
#define EXACT_M 0.08     /* the same where errors of the whole scanner are tried */
#define BLIND_S 0.35     /* without ranges for longer the scanner is blind */
#define STUCK_SCANS 5    /* so many repeated scans are no chance */
#define SETTLE_S 1.0     /* a state ends when a better one was found for this long */
#define SECTOR_RETURNS 8 /* a sector is judged by at least so many predicted returns */
#define LOST_SECTORS 3   /* with so many lost sectors the scanner is blind */
#define AHEAD_RAD 0.35   /* a lost sector within this angle hides the way */
#define SEEN_M 4.0       /* the farthest that is ever seen ahead */
#define SECTORS (SCANLOOP_BEAMS / SCANLOOP_SECTOR_BEAMS)

/* Errors of the scanner that are tried: reported range per true one, and mounting angle. The first is no error. */
static const double ERRORS[][2] = {{1.0, 0.0},  {0.6, 0.0},  {0.7, 0.0}, {0.8, 0.0}, {1.25, 0.0}, {1.4, 0.0}, {1.6, 0.0},
                                   {1.0, -0.3}, {1.0, -0.2}, {1.0, 0.2}, {1.0, 0.3}};
#define TRIED ((int)(sizeof ERRORS / sizeof ERRORS[0]))

/* A scan with the motion of the robot during the sweep. */
struct view {
    double x_m, y_m, yaw_rad, course_rad, speed_mps, yaw_rate_radps;
    uint64_t sweep_ns; /* 0 when there is no scan yet */
    uint32_t ranges_mm[SCANLOOP_BEAMS];
};

/* What the health of the next scan depends on. */
struct health {
    struct view before, keyframe;
    double predicted, came, right;    /* returns of the scan before, with a memory of some scans */
    double explained[TRIED];          /* returns that each error explains, with a memory of some keyframes */
    double blind_s, better_s;
    uint32_t state, identical;
    uint8_t empty_scans[SECTORS + 2]; /* scans in a row in which nothing predicted came from a sector */
};

/* Returns that were predicted, those that came, and those at their predicted range. */
struct match {
    double predicted, came, right;
};

static struct view view_of(const scanloop_scan *scan, const scanloop_pose *pose) {
    struct view view = {
        .x_m = pose->x_m, .y_m = pose->y_m, .yaw_rad = pose->yaw_rad,
        .course_rad = pose->yaw_rad + pose->sideslip_rad, .speed_mps = pose->speed_mps,
        .yaw_rate_radps = pose->yaw_rate_radps, .sweep_ns = scan->sweep_ns,
    };
    memcpy(view.ranges_mm, scan->ranges_mm, sizeof view.ranges_mm);
    return view;
}

/* The range of a beam in metres, 0 without a return. */
static double range_of(const struct view *view, int beam) {
    double range = view->ranges_mm[beam] * 1e-3;
    return view->ranges_mm[beam] < SCANLOOP_MIN_RANGE_MM || range > MAX_RANGE_M ? 0.0 : range;
}

/* Where the scanner is at the time of a beam: x, y and direction of the beam. The robot moves during the sweep. */
static void aim(const struct view *view, double beam, double ray[3]) {
    double since_s = (beam - SCANLOOP_FRONT_BEAM) / SCANLOOP_BEAMS * (double)view->sweep_ns * 1e-9;
    ray[0] = view->x_m + view->speed_mps * since_s * cos(view->course_rad);
    ray[1] = view->y_m + view->speed_mps * since_s * sin(view->course_rad);
    ray[2] = view->yaw_rad + view->yaw_rate_radps * since_s + SCANLOOP_FIRST_BEAM_YAW_RAD + beam * SCANLOOP_PITCH_RAD;
}

/* The position of the return of a beam; 0 when there is no return. */
static int place(const struct view *view, int beam, const double error[2], double at[2]) {
    double range = range_of(view, beam) / error[0], ray[3];
    aim(view, beam, ray);
    at[0] = ray[0] + range * cos(ray[2] + error[1]);
    at[1] = ray[1] + range * sin(ray[2] + error[1]);
    return range > 0.0;
}

/* The beam that shows a position, and the range that it reports; -1 when it is out of the sweep. */
static int beam_to(const struct view *view, const double at[2], const double error[2], double *range) {
    double beam = SCANLOOP_FRONT_BEAM;
    for (int round = 0; round < 2; round++) { /* the second time from where the robot is at the time of the beam */
        double ray[3];
        aim(view, beam, ray);
        double x = at[0] - ray[0], y = at[1] - ray[1];
        beam += remainder(atan2(y, x) - ray[2] - error[1], 2 * acos(-1.0)) / SCANLOOP_PITCH_RAD;
        *range = hypot(x, y) * error[0];
    }
    return beam >= 0.0 && beam < SCANLOOP_BEAMS - 0.5 ? (int)lround(beam) : -1;
}

/* Compares a scan with what an earlier one predicts, if the scanner has this error. */
static struct match compare(const struct view *before, const struct view *now, const double error[2], double exact_m) {
    struct match match = {0.0, 0.0, 0.0};
    for (int beam = 0; beam < SCANLOOP_BEAMS; beam++) {
        double at[2], expected;
        int there = place(before, beam, error, at) ? beam_to(now, at, error, &expected) : -1;
        if (there >= 0 && expected < PREDICTED_M) {
            double range = range_of(now, there);
            match.predicted += 1.0;
            match.came += range > 0.0;
            match.right += range > 0.0 && fabs(range - expected) < exact_m;
        }
    }
    return match;
}

/* Counts the scans in which nothing came from a sector although walls are expected there. What stands on the track,
 * between `y_m`, may have moved away. */
static void watch_sectors(struct health *health, const struct view *now, const double y_m[2]) {
    int predicted[SECTORS] = {0}, came[SECTORS] = {0}, returns[SECTORS] = {0};
    for (int beam = 0; beam < SCANLOOP_BEAMS; beam++) {
        double at[2], expected;
        returns[beam / SCANLOOP_SECTOR_BEAMS] += range_of(now, beam) > 0.0;
        if (!place(&health->keyframe, beam, ERRORS[0], at) || (at[1] > y_m[0] && at[1] < y_m[1])) {
            continue;
        }
        int there = beam_to(now, at, ERRORS[0], &expected);
        if (there >= 0 && expected < PREDICTED_M) {
            predicted[there / SCANLOOP_SECTOR_BEAMS]++;
            came[there / SCANLOOP_SECTOR_BEAMS] += range_of(now, there) > 0.0;
        }
    }
    for (int sector = 0; sector < SECTORS; sector++) {
        uint8_t *empty = &health->empty_scans[sector];
        if (returns[sector] >= 3) {
            *empty = 0;
        } else if (predicted[sector] >= SECTOR_RETURNS && came[sector] == 0 && *empty < 2) {
            *empty += 1;
        }
    }
}

/* The sectors that are lost, one bit each. */
static uint64_t lost_sectors(const struct health *health) {
    uint64_t lost = 0;
    for (int sector = 0; sector < SECTORS; sector++) {
        lost |= (uint64_t)(health->empty_scans[sector] == 2) << sector;
    }
    return lost;
}

/* Tries the errors of the scanner on two scans some way apart. */
static void try_errors(struct health *health, const struct view *now) {
    for (int error = 0; error < TRIED; error++) {
        double right = compare(&health->keyframe, now, ERRORS[error], EXACT_M).right;
        health->explained[error] = 0.8 * health->explained[error] + right;
    }
}

/* Whether an error of the scanner explains the scans better than none does. */
static int contradicts(const struct health *health) {
    double best = 0.0;
    for (int error = 1; error < TRIED; error++) {
        best = fmax(best, health->explained[error]);
    }
    return best > 1.05 * health->explained[0] + 10.0;
}

/* Takes a scan into account; returns whether it shows obstacles, or is as if it had not come. */
static int check_scan(struct health *health, const struct view *now, const double y_m[2], double elapsed_s) {
    const struct view *before = &health->before;
    double way = hypot(now->x_m - before->x_m, now->y_m - before->y_m);
    int count = 0, had_scan = before->sweep_ns > 0;
    for (int beam = 0; beam < SCANLOOP_BEAMS; beam++) {
        count += range_of(now, beam) > 0.0;
    }
    int is_empty = count < MIN_SHARE * SCANLOOP_BEAMS;
    int is_same = had_scan && memcmp(now->ranges_mm, before->ranges_mm, sizeof now->ranges_mm) == 0;
    if (is_empty || (is_same && way > MOVED_M)) {
        health->identical += is_same && !is_empty;
        health->blind_s += elapsed_s;
        return 0;
    }
    health->blind_s = 0.0;
    if (is_same) {
        return 1; /* at rest the same ranges may come again */
    }
    health->identical = 0;
    struct match match = had_scan ? compare(before, now, ERRORS[0], RIGHT_M) : (struct match){0.0, 0.0, 0.0};
    double keep = exp(-elapsed_s / 0.3);
    health->predicted = keep * health->predicted + match.predicted;
    health->came = keep * health->came + match.came;
    health->right = keep * health->right + match.right;
    health->before = *now;
    if (health->keyframe.sweep_ns == 0) {
        health->keyframe = *now;
    }
    watch_sectors(health, now, y_m);
    if (hypot(now->x_m - health->keyframe.x_m, now->y_m - health->keyframe.y_m) > KEYFRAME_M) {
        try_errors(health, now);
        health->keyframe = *now;
    }
    return match.came < 30.0 || match.right > 0.3 * match.came;
}

/* The state that the last scan alone tells. */
static uint32_t found_state(const struct health *health, int lost) {
    double returned = health->predicted > 40.0 ? health->came / health->predicted : 1.0;
    if (health->identical >= STUCK_SCANS) {
        return SCANLOOP_SCANNER_STATE_STUCK;
    }
    if (contradicts(health) || (health->came > 40.0 && health->right < 0.4 * health->came)) {
        return SCANLOOP_SCANNER_STATE_CONTRADICTORY;
    }
    if (health->blind_s > BLIND_S || returned < 0.15 || lost >= LOST_SECTORS) {
        return SCANLOOP_SCANNER_STATE_BLIND;
    }
    return returned < 0.6 ? SCANLOOP_SCANNER_STATE_DEGRADED : SCANLOOP_SCANNER_STATE_HEALTHY;
}

/* Fills the health of the sample; a state ends only when a better one was found for some time. */
static scanloop_scanner_health describe_health(struct health *health, const scanloop_scan *scan, double elapsed_s) {
    uint64_t lost = lost_sectors(health);
    int count = 0, is_hidden = 0, valid = 0, window = 0;
    for (int sector = 0; sector < SECTORS; sector++) {
        double middle = (sector + 0.5) * SCANLOOP_SECTOR_BEAMS - SCANLOOP_FRONT_BEAM;
        int is_lost = lost >> sector & 1;
        count += is_lost;
        is_hidden |= is_lost && fabs(middle * SCANLOOP_PITCH_RAD) < AHEAD_RAD;
    }
    for (int beam = SCANLOOP_FIRST_ANALYSED_BEAM; beam <= SCANLOOP_LAST_ANALYSED_BEAM; beam++, window++) {
        valid += scan->ranges_mm[beam] >= SCANLOOP_MIN_RANGE_MM;
    }
    uint32_t found = found_state(health, count);
    health->better_s = found < health->state ? health->better_s + elapsed_s : 0.0;
    if (found >= health->state || health->better_s >= SETTLE_S) {
        health->state = found;
        health->better_s = 0.0;
    }
    double returned = health->predicted > 0.0 ? health->came / health->predicted : 1.0;
    double seen_m = is_hidden ? 0.0 : fmin(SEEN_M, 0.1 * returned / (3 * SCANLOOP_PITCH_RAD));
    return (scanloop_scanner_health){
        .state = health->state, .identical_scans = health->identical, .unseen_sectors = lost,
        .valid_share = (double)valid / window, .returned_share = returned, .blind_s = health->blind_s,
        .seen_ahead_m = fmax(seen_m - 2.0 * health->blind_s, 0.0), .range_factor = 1.0,
    };
}
