#!/bin/sh
# A regression test of a controller: regression-test.sh COMMAND [TOLERANCE]
#
# The program gets the inputs of a recorded drive. Exit code 1 if one of its commands differs more from the recorded one than
# two processes of a swap may. Keep a recording of a drive that went well instead of making a new one each time.
set -eu
test -e drive.mcap || scanloop run corridor --lockstep --quiet --record=drive.mcap
exec scanloop replay drive.mcap --with "controller=$1" --tolerance "${2:-1}"
