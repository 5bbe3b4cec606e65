#!/bin/sh
# Every package of deploy/requirements.lock as a file for 64-bit ARM (Raspberry Pi OS, Debian 12 and newer), with the
# hashes of the lock: looked up in the package index, and downloaded with --download DIR (200 MB), by an ordinary pip.
#
#   sh deploy/aarch64.sh [--download DIR] [PYTHON_VERSION...]     default: 3.11 (Debian 12) and 3.13 (Debian 13)
#
# Exit code 1 if a package has none.
set -eu
root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
# shellcheck source=deploy/env.sh
. "$root/deploy/env.sh"
target=
if [ "${1:-}" = --download ]; then
    target=${2:?--download needs a directory}
    shift 2
fi
[ $# -gt 0 ] || set -- 3.11 3.13
heft_env hil
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
platforms=
for minor in 17 24 26 27 28 31 34 35 36; do    # glibc of Debian 12 is 2.36
    platforms="$platforms --platform manylinux_2_${minor}_aarch64"
done
code=0
for version in "$@"; do
    # markers of the lock are of the machine that runs pip: nothing in it depends on the processor but what is named here
    "$heft_venv/bin/python" - "$root/deploy/requirements.lock" "$version" >"$work/lock" <<'END'
import re
import sys

from packaging.markers import Marker

text = open(sys.argv[1], encoding="utf-8").read()
here = {"platform_machine": "aarch64", "sys_platform": "linux", "platform_system": "Linux", "os_name": "posix"}
here |= {"python_version": sys.argv[2], "python_full_version": f"{sys.argv[2]}.0", "implementation_name": "cpython"}
for block in re.findall(r"(?m)^[A-Za-z0-9].*(?:\n +--hash.*)*", text):
    first, _, rest = block.partition("\n")
    requirement, _, marker = first.rstrip(" \\").partition(" ; ")
    if not marker or Marker(marker).evaluate(here):
        print(requirement + (" \\\n" + rest if rest else ""))
END
    # shellcheck disable=SC2086
    if [ -n "$target" ]; then
        set -- download --dest "$target/$version"
    else
        set -- install --dry-run --ignore-installed --target "$work/none" --report "$work/report"
    fi
    # shellcheck disable=SC2086
    if "$heft_venv/bin/python" -m pip "$@" --quiet --no-deps --require-hashes --only-binary :all: $platforms \
        --python-version "$version" --implementation cp --abi "cp$(echo "$version" | tr -d .)" --abi abi3 --abi none \
        -r "$work/lock" >"$work/out" 2>&1; then
        printf 'Python %s: all %s packages have a file for aarch64\n' "$version" "$(grep -c == "$work/lock")"
    else
        cat "$work/out" >&2
        code=1
    fi
done
exit $code
