#!/usr/bin/env bash
# Installs what the benches are compared with, into folders below this one only.
#
#   setup.sh          casadi: the virtual environment that `scanloop bench solver --peer` runs CasADi (with IPOPT) in, about
#                     100 MB from PyPI. Needs Python 3 with venv; a C compiler makes the peers faster when there is one.
#   setup.sh acados   acados with CasADi, 13 MB from PyPI; needs make and a C compiler
#   setup.sh zenoh    the program behind `zenoh` and `zenoh-shm` of `scanloop bench transport`, from crates.io
#   setup.sh zeromq   the program behind `zeromq`, from crates.io; compiles libzmq, needs a C++ compiler
#   setup.sh dora     the program behind `dora`, from crates.io, and dora's own program from PyPI (with venv)
#   setup.sh all      all of them
#
# Zenoh and dora take some minutes each. CARGO_BUILD_JOBS=1 leaves the other processors alone.
set -euo pipefail
cd "$(dirname "$0")"
export CARGO_TARGET_DIR="$PWD/target"

environment() { # FOLDER ARGUMENTS OF PIP...
    [ -x "$1/bin/python" ] || python3 -m venv "$1"
    "$1/bin/python" -m pip install --quiet "${@:2}"
}

install() {
    case "$1" in
        casadi)
            environment .venv "casadi==3.8.2"
            .venv/bin/python -c "import casadi; print('casadi', casadi.__version__)"
            ;;
        acados)
            # The wheel brings a CasADi of its own for another Python, which the other peers' one replaces.
            environment .venv --no-deps "comma-deps-acados==0.2.2.post92"
            environment .venv --force-reinstall "casadi==3.8.2"
            .venv/bin/python -c "import acados, casadi; print('acados beside casadi', casadi.__version__)"
            ;;
        zenoh | zeromq)
            (cd "$1" && cargo build --release)
            ;;
        dora)
            (cd dora && cargo build --release)
            environment dora/.venv --no-deps "dora-rs-cli==1.1.0"
            dora/.venv/bin/dora --version
            ;;
        *)
            echo "unknown peer \`$1\`: expected casadi, acados, zenoh, zeromq, dora or all" >&2
            exit 2
            ;;
    esac
}

[ $# -gt 0 ] || set -- casadi
[ "$1" != all ] || set -- casadi acados zeromq zenoh dora
for name in "$@"; do
    install "$name"
done
