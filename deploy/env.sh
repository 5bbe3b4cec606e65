# The checkout's own Python environment, made once. Sourced (POSIX sh) by hil.sh, test.sh and .ci/run, which set `root`.
#
#   heft_env hil     .venv with what deploy/requirements.lock pins, and heft itself (editable)
#   heft_env test    the same, and the test tools of deploy/requirements-test.lock
#
# Sets `heft_venv`. Exits 69 when this system lacks something (the message is the command that mends it) and 75 when the
# installation broke off (run it again). A stamp in .venv, keyed by the locks, pyproject.toml, this file, the checkout's
# place and the Python version, lets the next run start at once, without pip or a network.
# shellcheck shell=sh
: "${root:?is the checkout, set by the script that sources this}"

unset PYTHONPATH PYTHONHOME    # packages of another distribution (ROS, for one) must not shadow the locked ones
unset PYTHONDONTWRITEBYTECODE    # the suite starts a few hundred Pythons: none compiles again what another has
export PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_INPUT=1
export OPENBLAS_NUM_THREADS="${OPENBLAS_NUM_THREADS:-1}"    # matrices of 10 to 70 columns: a second thread only costs

heft_die() {
    heft_code=$1
    shift
    printf 'heft: %s\n' "$@" >&2
    exit "$heft_code"
}

# Sets heft_python to the first interpreter that is new enough; HEFT_PYTHON names another one to take.
heft_find_python() {
    heft_old=
    for heft_python in "${HEFT_PYTHON:-python3}" python3.14 python3.13 python3.12 python3.11; do
        if command -v "$heft_python" >/dev/null 2>&1; then
            "$heft_python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' && return 0
            heft_old=${heft_old:-"$heft_python is $("$heft_python" -V 2>&1)"}
        fi
        [ -z "${HEFT_PYTHON:-}" ] || heft_die 69 "HEFT_PYTHON=$HEFT_PYTHON is no Python 3.11 or newer: name one that is."
    done
    [ -n "$heft_old" ] || heft_die 69 'there is no Python here. Run: sudo apt install python3 python3-venv'
    heft_die 69 "$heft_old; heft needs 3.11 or newer: Debian 12 or Raspberry Pi OS bookworm." \
        "If another Python is installed: HEFT_PYTHON=/path/to/python3.11 sh $0"
}

# Everything that the packages to be installed take from the system, asked for in one message.
heft_check_system() {
    heft_version=$("$heft_python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    "$heft_python" -c 'import struct, sys; sys.exit(struct.calcsize("P") != 8)' ||
        heft_die 69 'this is a 32-bit Python; Pinocchio and MuJoCo need a 64-bit system.'
    heft_missing=
    "$heft_python" -c 'import ensurepip, venv' 2>/dev/null || heft_missing="$heft_missing python$heft_version-venv"
    "$heft_python" -c 'import ctypes; ctypes.CDLL("libgomp.so.1")' 2>/dev/null || heft_missing="$heft_missing libgomp1"
    [ -z "$heft_missing" ] || heft_die 69 "this system lacks$heft_missing. Run: sudo apt install$heft_missing"
}

# Prints the key of what .venv should hold; nothing when .venv has no working Python.
heft_key() {
    heft_tag=$("$heft_venv/bin/python" -c 'import sys; print(sys.version_info[:2])' 2>/dev/null) || return 0
    (
        cd "$root/deploy" || exit
        pwd
        printf '%s\n' "$heft_tag"
        cat ../pyproject.toml env.sh backend.py requirements*.lock ../onboard/native/*.py ../onboard/native/src/*
    ) | sha256sum | cut -d ' ' -f 1
}

# Whether a C compiler with the C library's headers is there: onboard/native is compiled with it, else with ziglang's.
heft_compiler() {
    for heft_cc in cc gcc clang; do
        ! echo '#include <stdlib.h>' | "$heft_cc" -fsyntax-only -x c - 2>/dev/null || return 0
    done
    return 1
}

heft_pip() {
    "$heft_venv/bin/python" -m pip install --progress-bar off "$@" >&2 || heft_pip_broke
}

heft_pip_broke() {
    heft_die 75 'the installation broke off (see above). Run the same command again; what is there already is kept.'
}

# Installs the packages of a lock, every other one beside the rest: unpacking them keeps a core busy for a minute. In a
# subshell, for what is in a script's background hears no Ctrl-C: it is ended with it.
heft_locked() (
    heft_parts=$(mktemp -d) && trap 'rm -rf "$heft_parts"' EXIT
    trap 'kill $heft_pids 2>/dev/null; exit 130' INT TERM HUP
    awk -v to="$heft_parts/part." '/^[^ #]/ { n++ } { print > (to n % 2) }' "$root/deploy/$1"
    shift
    heft_pids=
    for heft_part in 0 1; do
        "$heft_venv/bin/python" -m pip install --progress-bar off "$@" --no-deps --require-hashes \
            --only-binary :all: -r "$heft_parts/part.$heft_part" >&2 &
        heft_pids="$heft_pids $!"
    done
    heft_broken=
    for heft_pid in $heft_pids; do wait "$heft_pid" || heft_broken=1; done
    [ -z "$heft_broken" ] || heft_pip_broke
)

# Installs ziglang, a C compiler for this processor and others, into .venv.
heft_zig() {
    heft_pip --no-deps --require-hashes --only-binary :all: -r "$root/deploy/requirements-compiler.lock"
}

heft_env() {
    heft_venv=$root/.venv
    heft_stamp=$heft_venv/heft-$1
    heft_now=$(heft_key)
    if [ -n "$heft_now" ] && [ -f "$heft_stamp" ] && [ "$(cat "$heft_stamp")" = "$heft_now" ]; then
        return 0
    fi
    case $1 in
        hil) heft_lock=requirements.lock heft_grants=hil heft_compile= heft_size='200 MB to fetch, 900 MB on disk' ;;
        test)    # no test imports most of the modules: Python compiles those that are imported when they are
            heft_lock=requirements-test.lock heft_grants='hil test' heft_compile=--no-compile
            heft_size='340 MB to fetch, 1.4 GB on disk'
            ;;
        *) heft_die 64 "no environment is called $1: hil or test." ;;
    esac
    if ! "$heft_venv/bin/python" -m pip --version >/dev/null 2>&1; then
        heft_find_python
        heft_check_system
        "$heft_python" -m venv --clear "$heft_venv" || heft_die 75 "could not make $heft_venv (see above)."
    fi
    printf 'heft: installing into %s, once (%s)\n' "$heft_venv" "$heft_size" >&2
    rm -f "$heft_venv/heft-hil" "$heft_venv/heft-test"
    # shellcheck disable=SC2086  # none or one option
    heft_locked "$heft_lock" $heft_compile || exit
    heft_compiler || heft_zig
    heft_pip --quiet --no-deps --no-index --no-build-isolation --editable "$root"
    for heft_grant in $heft_grants; do
        heft_key >"$heft_venv/heft-$heft_grant"
    done
}
