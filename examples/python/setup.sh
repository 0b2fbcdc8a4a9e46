#!/usr/bin/env bash
# Makes the virtual environment of the Python examples in target/python, or in the folder given. The first time it
# downloads about 150 MB from PyPI, later nothing. Needs Python 3.11 with venv.
set -euo pipefail
cd "$(dirname "$0")"
folder="${1:-../../target/python}"
[ -x "$folder/bin/python" ] || "${PYTHON:-python3}" -m venv "$folder"
if ! "$folder/bin/python" -c 'import casadi, iceoryx2, mcap, rosbags' 2>/dev/null; then
    "$folder/bin/python" -m pip install --quiet --disable-pip-version-check --requirement requirements.txt
fi
"$folder/bin/python" -c 'import sys; assert sys.version_info >= (3, 11), "Python 3.11 is needed"'
