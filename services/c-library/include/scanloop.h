/* A process of Scanloop in C.
 *
 *     cc -std=c11 my_process.c -Iexamples/c -Iservices/c-library/include -Ltarget/release -lscanloop -o my_process
 *
 * Link with libscanloop.so, or with libscanloop.a and -lpthread -ldl -lm. The samples are in scanloop_types.h, which
 * `scanloop types --c` prints. The library does what all processes have in common: it waits, drops and counts samples
 * that do not count, copies stamps, sends heartbeats and journals, waits at the start barrier, and ends on SIGTERM and SIGINT.
 *
 * A process has one thread that calls these functions, from scanloop_open to scanloop_close. No function waits without
 * a time-out. Functions that return int return one of the results below; for a negative one, scanloop_last_error gives
 * the message. A program should end on a negative result: the orchestrator starts it again.
 */
#ifndef SCANLOOP_H
#define SCANLOOP_H

#include "scanloop_types.h"

#ifdef __cplusplus
extern "C" {
#endif

enum scanloop_result {
    SCANLOOP_REFUSED = -6,        /* a person does not drive, or a goal is not taken: the error has the reason */
    SCANLOOP_BUS_ERROR = -5,      /* the bus or a file of the system failed */
    SCANLOOP_BAD_SAMPLE = -4,     /* a sample has a number that is not finite or out of range; nothing was published */
    SCANLOOP_OTHER_LAYOUT = -3,   /* built against other samples than the system: the error names topic and field */
    SCANLOOP_NOT_IN_A_SYSTEM = -2, /* started by hand, not by `scanloop run` or `scanloop swap` */
    SCANLOOP_BAD_ARGUMENT = -1,   /* a null pointer, an unknown topic, a wrong size */
    SCANLOOP_NO = 0,              /* no sample or value, or the process must end */
    SCANLOOP_YES = 1
};

/* What scanloop_resume finds. */
enum scanloop_handover {
    SCANLOOP_FIRST_START = 0, /* nothing ran before */
    SCANLOOP_RESUMED = 1,     /* the state of the process before */
    SCANLOOP_FOREIGN = 2,     /* the process before was another program, whose state is of another kind */
    SCANLOOP_LOST = 3         /* its state was older than half a second when it ended, or was never saved: publish
                                 nothing unless your outputs need no memory, so that the wheels stay blocked */
};

enum scanloop_log_level { SCANLOOP_DEBUG = 0, SCANLOOP_INFO = 1, SCANLOOP_WARN = 2, SCANLOOP_ERROR = 3 };

/* A process of the loop. */
typedef struct scanloop_process scanloop_process;

/* Joins the system that started this program, as `role` (enum scanloop_role), and opens all topics of the role.
 *
 *     scanloop_process *process;
 *     if (scanloop_open(SCANLOOP_ROLE_OBSTACLES, SCANLOOP_LAYOUTS, &process) < 0) {
 *         fprintf(stderr, "%s\n", scanloop_last_error());
 *         return 2;
 *     }
 *
 * SCANLOOP_LAYOUTS is the table of scanloop_types.h: a header or a library of another version is refused here. */
int scanloop_open(uint32_t role, const scanloop_layout_row *layouts, size_t count, scanloop_process **process);

/* Waits until all processes are ready and connected. SCANLOOP_YES: drive; SCANLOOP_NO: the process must end.
 * Before it, no sample can be read, but scanloop_resume and scanloop_setting work. */
int scanloop_start(scanloop_process *process);

/* Sleeps until a sample has come, the time `deadline_ns` (0: none) has passed, or a tenth of a second has.
 * SCANLOOP_YES: read the samples; SCANLOOP_NO: the process must end. */
int scanloop_wait(scanloop_process *process, uint64_t deadline_ns);

/* The oldest sample of `topic` not read yet, in shared memory; SCANLOOP_NO when there is none.
 *
 * The pointer is valid until the next read of the same topic, by this function or the next, or scanloop_close. What it
 * points to must not be written. It has the type of the topic, is valid, and comes from the process in charge. */
int scanloop_read(scanloop_process *process, const char *topic, const void **sample);

/* A pair of samples of one scan: scan and pose for obstacles, pose and obstacles for the controller. It is the oldest
 * pair while all that wait can be answered in time, else the newest; older samples are then dropped.
 * SCANLOOP_NO while no pair is complete. Call it until then, because scanloop_wait does not return for samples that came
 * before. Pointers as in scanloop_read. */
int scanloop_join(scanloop_process *process, const void **first, const void **second);

/* The header of an answer to the sample with header `to`, and to the one with header `also` (or NULL): same scan,
 * stamps of both. */
void scanloop_answer(const scanloop_header *to, const scanloop_header *also, scanloop_header *answer);

/* Completes the header of `sample` and publishes a copy of it; `size` is sizeof of its struct. */
int scanloop_publish(scanloop_process *process, const char *topic, void *sample, size_t size);

/* The robot's process, before it publishes the samples of a scan: work begins without an input. */
int scanloop_begin(scanloop_process *process);

/* Publishes the state of this process after the scan of `header`, at most SCANLOOP_CHECKPOINT_BYTES, for its successor.
 * `kind` is a number of your own for this layout of the state; change it with the layout. */
int scanloop_save(scanloop_process *process, const scanloop_header *header, uint32_t kind, const void *state,
                  size_t size);

/* Fills `state` with the last state that the process before this one saved. Returns an enum scanloop_handover, or an error.
 *
 * That process may have hung, and the wheels may have been blocked since; the actuations that it did not receive are
 * not available here. An estimator that predicts from actuations should trust the measured speed after a gap. */
int scanloop_resume(scanloop_process *process, uint32_t kind, void *state, size_t size);

/* A number of the settings of the role, docs/system-file.md: "safety_distance_m", "wall_y_m.0", "track.y_m.1"; true is 1.
 * Every documented key exists; the robot's settings are the scenario.
 * SCANLOOP_NO, and `value` unchanged, when there is no such number. */
int scanloop_setting(scanloop_process *process, const char *key, double *value);

/* The time of the loop [ns]: CLOCK_MONOTONIC, or simulated time in lock-step. */
uint64_t scanloop_now_ns(scanloop_process *process);

/* Time between two scans [ns]. */
uint64_t scanloop_period_ns(scanloop_process *process);

/* Reports what the wheels do, so that a stop can be confirmed; SCANLOOP_TURNING, SCANLOOP_BLOCKED or SCANLOOP_RESTING. A
 * robot calls it each time it wakes; for an actuator its output does. */
enum scanloop_wheels { SCANLOOP_TURNING = 1, SCANLOOP_BLOCKED = 2, SCANLOOP_RESTING = 3 };
int scanloop_report_wheels(scanloop_process *process, uint32_t wheels);

/* Reports what the devices behind this process do, and why in a few words (or NULL), for `scanloop status`: one of enum
 * scanloop_device_state. A driver calls it each time it wakes; of a long reason the first 96 bytes count. */
int scanloop_report_device(scanloop_process *process, uint32_t state, const char *reason);

/* The counters of this process and the newest directive; either may be NULL. `stop` of the directive is 1 also when the
 * run was stopped for good, or no directive came for orphan_stop_s. Then an actuator's port sends no actuation that
 * drives, and a robot's port delivers none. */
int scanloop_status(scanloop_process *process, scanloop_heartbeat *counters, scanloop_directive *orders);

/* A topic that the system file adds. `layout` and `count` are the table that `scanloop types --c --layout FILE` prints and
 * its length:
 *
 *     scanloop_open_topic(process, "imu", scanloop_imu_layout,
 *                         sizeof scanloop_imu_layout / sizeof scanloop_imu_layout[0], &imu);
 *
 * A process of the loop opens those that `also_reads` gives to it, before scanloop_start. */
typedef struct scanloop_topic scanloop_topic;
int scanloop_open_topic(scanloop_process *process, const char *name, const scanloop_layout_row *layout, size_t count,
                        scanloop_topic **topic);

/* The oldest sample not taken yet; the newest; that of one scan. SCANLOOP_NO when there is none. Nothing is waited for in
 * real time; in lock-step the last two wait until the writer is done with `scan_id`. The pointer is valid until the next
 * of these calls for the same topic, or scanloop_topic_close. */
int scanloop_topic_take(scanloop_topic *topic, const void **sample);
int scanloop_topic_newest(scanloop_topic *topic, uint64_t scan_id, const void **sample);
int scanloop_topic_by_scan(scanloop_topic *topic, uint64_t scan_id, const void **sample);

/* Completes header and `stage` of `sample` and publishes a copy of it; `size` is sizeof of its struct. */
int scanloop_topic_publish(scanloop_topic *topic, void *sample, size_t size);

/* Frees the topic; NULL is allowed. */
void scanloop_topic_close(scanloop_topic *topic);

/* A process beside the loop, docs/companions.md. It opens topics of the loop by name, and topics of your own with their
 * layout; then it starts, and waits for samples of the first topic in `reads`. */
typedef struct scanloop_companion scanloop_companion;
int scanloop_companion_open(scanloop_companion **companion);
int scanloop_companion_input(scanloop_companion *companion, const char *name, scanloop_topic **topic);
int scanloop_companion_topic(scanloop_companion *companion, const char *name, const scanloop_layout_row *layout,
                             size_t count, scanloop_topic **topic);
int scanloop_companion_start(scanloop_companion *companion);
int scanloop_companion_wait(scanloop_companion *companion, uint64_t deadline_ns);
void scanloop_companion_close(scanloop_companion *companion);

/* A person who drives a running system by hand, from any program: a process of `scanloop teleop --stdin`. The executable is
 * that of the variable SCANLOOP, else `scanloop` in PATH.
 *
 * scanloop_person_take_over takes over the drive of a system, of SCANLOOP_SYSTEM_ID for NULL. scanloop_person_give asks for a
 * velocity [m/s] and a steering angle [rad], positive to the left; it never waits. The wheels are blocked without a new control
 * within 1.5 scan periods. scanloop_person_pause blocks them until the next one, scanloop_person_resume hands back to the
 * controller. scanloop_person_close frees the person, and pauses the drive unless it was handed back; NULL is allowed.
 * SCANLOOP_REFUSED: another person drives, the drive was paused or has ended; scanloop_last_error has the reason. */
typedef struct scanloop_person scanloop_person;
int scanloop_person_take_over(const char *system_id, scanloop_person **person);
int scanloop_person_give(scanloop_person *person, double velocity_mps, double steering_rad);
int scanloop_person_pause(scanloop_person *person);
int scanloop_person_resume(scanloop_person *person);
void scanloop_person_close(scanloop_person *person);

/* Sets the place [m] of the goal that a running system drives to, and the direction there [rad] unless `yaw_rad` is NULL, from
 * any program, as `scanloop set` does; the executable is found as that of a person. It waits for the answer, so no process of
 * the loop calls it between two scans. `from_scan`, if it is not NULL, receives the first scan for which the goal counts.
 *
 *     if (scanloop_set_goal(NULL, 8.0, 0.4, NULL, NULL) < 0) {
 *         fprintf(stderr, "%s\n", scanloop_last_error());
 *     }
 *
 * A controller finds the goal in the newest directive, scanloop_status, and drives to it from its scan on. */
int scanloop_set_goal(const char *system_id, double x_m, double y_m, const double *yaw_rad, uint64_t *from_scan);

/* Writes a line to the log of the process, logs/ROLE.log; the user sees the last lines of a process that ends. */
void scanloop_log(int level, const char *text);

/* The message of the last negative result of this thread; valid until the next one. */
const char *scanloop_last_error(void);

/* Leaves the system and frees the process; NULL is allowed. */
void scanloop_close(scanloop_process *process);

#ifdef __cplusplus
}
#endif

#endif
