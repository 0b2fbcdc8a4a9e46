#!/bin/sh
# Whether a headless Chromium can be driven here. `--install` installs Debian's package where it is missing.
set -e
found() {
    command -v chromium || command -v chromium-browser || command -v google-chrome
}
command -v python3 >/dev/null || { echo "there is no python3" >&2; exit 1; }
found >/dev/null && exit 0
[ "$1" = --install ] || { echo "there is no Chromium; tests/browser/setup.sh --install installs it" >&2; exit 1; }
as_root() {
    if [ "$(id -u)" = 0 ]; then "$@"; else sudo -n "$@"; fi
}
# Another program may hold the lock of the lists, for which there is no timeout.
tries=1
until as_root apt-get update -qq >&2; do
    [ "$tries" -lt 10 ] || exit 1
    tries=$((tries + 1))
    sleep 5
done
as_root env DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=300 install -y -qq chromium >&2
found >/dev/null
