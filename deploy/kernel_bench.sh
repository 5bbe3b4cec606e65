#!/bin/sh
# The kernel tier: tests/kernel inside a user-mode Linux with real CAN, I2C, PPS and tty interfaces, the twins behind them.
#
#   sh deploy/kernel_bench.sh [ARG...]            pytest tests/kernel ARG...
#   sh deploy/kernel_bench.sh --exec COMMAND...   any other command, in the checkout, inside the guest
#
# Needs Debian 12 or newer on x86-64, and no root: packages are fetched by apt-get, with its signatures checked, and
# unpacked under HEFT_KERNEL_CACHE (default ~/.cache/heft), 160 MB, once; nothing is installed or changed on the machine.
# HEFT_KERNEL_RESULTS=DIR keeps what the guest writes to /run/results; HEFT_KERNEL_TIMEOUT (500) limits the guest, seconds.
# Exit codes: the command's; 69 when this machine cannot run it (the message says why), 70 when the guest died,
# 75 when the packages could not be fetched, 124 when the time was over.
set -eu
root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
# shellcheck source=deploy/env.sh
. "$root/deploy/env.sh"

packages='user-mode-linux can-utils i2c-tools libi2c0'
memory_mb=1536
cache=${HEFT_KERNEL_CACHE:-${XDG_CACHE_HOME:-${HOME:-/var/tmp}/.cache}/heft}

check_machine() {
    [ "$(uname -s)-$(uname -m)" = Linux-x86_64 ] ||
        heft_die 69 "the kernel tier needs Linux on x86-64; this is $(uname -sm). Debian has user-mode-linux for no other."
    for tool in apt-get dpkg-deb timeout; do
        command -v "$tool" >/dev/null 2>&1 ||
            heft_die 69 "the kernel tier needs $tool, which is not here: run it on Debian 12 or newer."
    done
    case $root/ in
        /run/* | /dev/* | /proc/* | /sys/*)
            heft_die 69 "the guest hides $root under its own file systems: move the checkout, to /tmp for one." ;;
    esac
}

# The guest's memory is a file in a directory that must be large enough and not mounted noexec.
find_memory() {
    for directory in "${TMPDIR:-}" /dev/shm /tmp /var/tmp; do
        [ -d "$directory" ] || continue
        free_kb=$(df -Pk "$directory" | awk 'NR == 2 { print $4 }')
        [ "${free_kb:-0}" -gt $((memory_mb * 1024)) ] || continue
        try=$(mktemp "$directory/heft-exec.XXXXXX" 2>/dev/null) || continue
        printf '#!/bin/sh\n' >"$try" && chmod +x "$try"
        runs=1
        "$try" 2>/dev/null || runs=0
        rm -f "$try"
        [ $runs = 0 ] || return 0
    done
    heft_die 69 "the guest needs $memory_mb MB in one of /dev/shm, /tmp, /var/tmp or TMPDIR, not mounted noexec."
}

# apt-get with indexes and downloads of its own: it needs no root, and leaves the machine's as they are.
apt() {
    APT_CONFIG=$cache/apt/apt.conf apt-get -qq "$@"
}

fetch_packages() {
    [ -f "$kernel/complete" ] && [ "$(cat "$kernel/complete")" = "$packages" ] && return 0
    printf 'heft: fetching %s into %s, once (42 MB)\n' "$packages" "$cache" >&2
    rm -rf "$kernel" "$cache/apt"
    mkdir -p "$kernel" "$cache/apt/state/lists/partial" "$cache/apt/archives/partial"
    cat >"$cache/apt/apt.conf" <<END
Dir::State "$cache/apt/state";
Dir::State::status "/var/lib/dpkg/status";
Dir::Cache "$cache/apt";
APT::Sandbox::User "";
APT::Update::Post-Invoke-Success:: "";
END
    apt update || heft_die 75 'apt-get could not fetch its indexes (see above). Run the same command again.'
    for package in $packages; do
        apt_found=$(APT_CONFIG=$cache/apt/apt.conf apt-cache policy "$package")
        [ -n "$apt_found" ] || heft_die 69 "apt knows no package $package: enable Debian's main archive in /etc/apt."
    done
    # shellcheck disable=SC2086
    (cd "$cache/apt" && apt download $packages) ||
        heft_die 75 'apt-get could not fetch the packages (see above). Run the same command again.'
    for package in "$cache"/apt/*.deb; do
        dpkg-deb --extract "$package" "$kernel"
    done
    rm -rf "$cache/apt"
    printf '%s' "$packages" >"$kernel/complete"
}

check_machine
find_memory
mkdir -p "$cache" || heft_die 69 "cannot make $cache: set HEFT_KERNEL_CACHE to a directory that can be written."
cache=$(CDPATH='' cd -- "$cache" && pwd -P)
kernel=$cache/kernel
heft_env test
fetch_packages

work=$(mktemp -d /tmp/heft-kernel.XXXXXX)    # its path goes on the kernel's command line: no blanks
trap 'rm -rf "$work"' EXIT
guest=
trap '[ -z "$guest" ] || kill "$guest"; exit 130' INT TERM HUP
mkdir "$work/uml"
if [ -n "${HEFT_KERNEL_RESULTS:-}" ]; then
    mkdir -p "$HEFT_KERNEL_RESULTS"
    ln -s "$(CDPATH='' cd -- "$HEFT_KERNEL_RESULTS" && pwd -P)" "$work/results"
    rm -f "$work/results/status"
else
    mkdir "$work/results"
fi
ln -s "$root" "$work/checkout"
ln -s "$kernel" "$work/kernel"
if [ "${1:-}" = --exec ]; then
    shift
    [ $# -gt 0 ] || heft_die 64 '--exec needs a command.'
else
    set -- python -m pytest -p no:cacheprovider -o testpaths=tests/kernel "$@"
fi
printf '%s\0' "$@" >"$work/command"
cat >"$work/init" <<END
#!/bin/sh
PYTHONDONTWRITEBYTECODE=1
export PYTHONDONTWRITEBYTECODE
$work/checkout/.venv/bin/python $work/checkout/deploy/kernel/guest.py $work
$work/checkout/.venv/bin/python $work/checkout/deploy/kernel/power_off.py
END
chmod +x "$work/init"
# Sources are compiled here: the guest cannot write, and each of its processes would compile them anew.
"$root/.venv/bin/python" -m compileall -q "$root/drivers" "$root/onboard" "$root/hil_sim" || true

# The guest plays hardware in real time: where that is allowed (root), it goes before what else runs on this machine, and
# on one processor, for it is several processes of which only one runs at a time.
first=
cpu=$(taskset -cp $$ 2>/dev/null | sed 's/.*[^0-9]//')
if [ -n "$cpu" ] && taskset -c "$cpu" chrt --rr 1 true 2>/dev/null; then
    first="taskset -c $cpu chrt --rr 1"
fi

# Boots the guest: seconds that it may take, the program that it begins with.
boot() {
    code=0
    # shellcheck disable=SC2086
    TMPDIR=$directory timeout --foreground -k 5 "$1" $first "$kernel/usr/bin/linux.uml" \
        "mem=${memory_mb}M" rootfstype=hostfs rootflags=/ root=/dev/root ro "init=$2" "uml_dir=$work/uml/" \
        con=null ssl=null con0=null,fd:1 quiet loglevel=1 selinux=0 </dev/null 2>"$work/uml/errors" &
    guest=$!
    wait "$guest" || code=$?
    guest=
}

boot "${HEFT_KERNEL_TIMEOUT:-500}" "$work/init"
if [ -f "$work/results/status" ]; then
    exit "$(cat "$work/results/status")"
fi
cat "$work/uml/errors" >&2
[ $code -ne 124 ] || heft_die 124 "the guest was stopped after ${HEFT_KERNEL_TIMEOUT:-500} s."
died=$code
boot 30 /bin/true    # the kernel says with which exit code its first program ended: 0, where programs run in it
grep -q 'Attempted to kill init! exitcode=0x00000000' "$work/uml/errors" ||
    heft_die 69 "not even /bin/true runs in a user-mode Linux on this machine. A container needs --cap-add SYS_PTRACE and \
executable memory in $directory; processors with AMX save more registers than this kernel can hand on."
heft_die 70 "the guest ended without a result (code $died)."
