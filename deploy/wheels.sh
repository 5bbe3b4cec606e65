#!/bin/sh
# Wheels of heft for x86-64 and 64-bit ARM (any Linux with glibc 2.28 or newer, any Python 3.11 or newer), each with the
# compiled core for its processor, and the list of their SHA-256, SHA256SUMS. Both are compiled with ziglang, so that the
# same sources make the same files on any computer.
#
#   sh deploy/wheels.sh DIR
#
# SOURCE_DATE_EPOCH, or else the time of the last commit, is the time of the files in them.
set -eu
root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
# shellcheck source=deploy/env.sh
. "$root/deploy/env.sh"
[ $# -eq 1 ] || heft_die 64 'name the directory for the wheels: sh deploy/wheels.sh DIR'
mkdir -p "$1"
made=$(CDPATH='' cd -- "$1" && pwd -P)
heft_env hil
heft_zig
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git -C "$root" log -1 --format=%ct)}
export SOURCE_DATE_EPOCH
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
trap 'exit 130' INT TERM
for machine in x86_64 aarch64; do
    mkdir "$work/$machine"    # a copy: what setuptools leaves in a checkout would come into the next wheel
    (cd "$root" && tar -cf - --exclude=__pycache__ --exclude='heft-*.so' \
        pyproject.toml README.md deploy heft onboard drivers hil_sim) | tar -xf - -C "$work/$machine"
    HEFT_WHEEL_MACHINE=$machine "$heft_venv/bin/python" -m pip wheel --quiet --no-deps --no-index --no-build-isolation \
        --wheel-dir "$work" "$work/$machine" >&2 || heft_die 70 "no wheel for $machine (see above)."
done
mv "$work"/*.whl "$made"
(cd "$made" && sha256sum heft_flight-*.whl | tee SHA256SUMS)
