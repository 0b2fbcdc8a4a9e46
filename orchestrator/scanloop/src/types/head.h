/* The samples of Scanloop. Made by `scanloop types --c`: do not edit, make it again.
 *
 * C11, fixed layout, no padding; lengths in metres, angles in radians counter-clockwise, x along the track, y to the
 * left. The assertions hold each struct to the layout it was made from; the table at the end is computed by your
 * compiler, and a process whose table differs from that of the system is refused with the field that differs. */
#ifndef SCANLOOP_TYPES_H
#define SCANLOOP_TYPES_H

#include <stddef.h>
#include <stdint.h>
