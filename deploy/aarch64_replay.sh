#!/bin/sh
# Replays logs on an emulated 64-bit ARM processor, with the packages of deploy/requirements.lock as a Raspberry Pi
# installs them: shows how far answers computed there are from those in the log. Debian 12 under qemu, in a directory that is
# removed afterwards (2 GB); three minutes, then some twenty times as long as a replay here.
#
#   sudo sh deploy/aarch64_replay.sh LOG...
#
# Exit code: that of the first `heft replay` that did not end with 0; 69 if this system lacks something.
set -eu
root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
# shellcheck source=deploy/env.sh
. "$root/deploy/env.sh"
[ $# -gt 0 ] || heft_die 64 'name the logs to replay: sudo sh deploy/aarch64_replay.sh flights/*.mcap'
[ "$(id -u)" = 0 ] || heft_die 69 "chroot needs root. Run: sudo sh $0 $*"
for heft_tool in debootstrap qemu-aarch64-static; do
    command -v "$heft_tool" >/dev/null || heft_die 69 'Run: apt install debootstrap qemu-user-static'
done
heft_env hil
heft_zig
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
trap 'exit 130' INT TERM
arm=$work/system

printf 'heft: packages for aarch64, into %s\n' "$work" >&2
sh "$root/deploy/aarch64.sh" --download "$work/wheels" 3.11 >&2
debootstrap --foreign --variant=minbase --arch=arm64 --include=python3,libgomp1 bookworm "$arm" >&2
for package in "$arm"/var/cache/apt/archives/*.deb; do    # unpacked, not configured: Python needs no more
    dpkg-deb --extract "$package" "$arm"
done
mkdir -p "$arm/site" "$arm/heft" "$arm/logs"
for wheel in "$work"/wheels/3.11/*.whl; do
    "$heft_venv/bin/python" -m zipfile -e "$wheel" "$arm/site"
done
cp -R "$root/onboard" "$root/drivers" "$root/heft" "$arm/heft"
"$heft_venv/bin/python" - "$arm/heft/onboard/native" <<'END'
import sys
from pathlib import Path

from onboard.native import build

build.compile_into(Path(sys.argv[1]) / build.file_name("aarch64"), build.zig("aarch64"))
END
cp "$(command -v qemu-aarch64-static)" "$arm/usr/bin"

code=0 prefix=/site/cmeel.prefix
for log in "$@"; do
    cp "$log" "$arm/logs/flight.mcap"
    printf '%s\n' "$log"
    env -i PATH="$PATH" HOME=/tmp OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE=1 LD_LIBRARY_PATH=$prefix/lib \
        PYTHONPATH=/heft:/site:$prefix/lib/python3.11/site-packages \
        chroot "$arm" /usr/bin/qemu-aarch64-static /usr/bin/python3.11 -m onboard.cli replay /logs/flight.mcap || code=$?
    [ "$code" = 0 ] || break
done
exit "$code"
