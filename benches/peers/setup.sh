#!/usr/bin/env bash
# Makes the virtual environment that `scanloop bench solver --peer` runs CasADi (with IPOPT) in: benches/peers/.venv
# About 100 MB from PyPI. Needs Python 3 with venv; a C compiler makes the peers faster and is used when there is one.
set -euo pipefail
cd "$(dirname "$0")"
[ -x .venv/bin/python ] || python3 -m venv .venv
.venv/bin/python -m pip install --quiet "casadi==3.8.2"
.venv/bin/python -c "import casadi; print('casadi', casadi.__version__)"
