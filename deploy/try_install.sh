#!/bin/sh
# Tries deploy/install.sh for real, in a fresh Debian root that is thrown away: as root, needs debootstrap, systemd-nspawn
# (package systemd-container), a network and 3 GB in /var/tmp (or TMPDIR).
#
#   sh deploy/try_install.sh [SUITE]      bookworm (default) or trixie
#
# It installs twice (the second time must change nothing), checks the unit with systemd-analyze, boots the root where this
# machine allows it, lets the service fly as systemd starts it for HEFT_TRY_FLIGHT_S (15), kills it, lets it go on with the
# flight, stops its supervisor (SIGSTOP) until the watchdog of systemd starts it again, reads the logs it made, uninstalls,
# and compares the files of the root with those before.
# HEFT_TRY_ROOT=FILE.tar keeps the fresh root for the next run. PIP_* variables are handed on. Exit codes: 0 all held;
# 69 this machine cannot do it; 1 something did not hold (the last line says what).
set -eu
root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
suite=${1:-bookworm}
note() { printf '\n== %s\n' "$*"; }
die() { printf 'try_install: %s\n' "$2" >&2 && exit "$1"; }
[ "$(id -u)" = 0 ] || die 69 'run it as root'
for tool in debootstrap systemd-nspawn; do
    command -v "$tool" >/dev/null 2>&1 || die 69 "no $tool here: apt install debootstrap systemd-container"
done

work=$(mktemp -d "${TMPDIR:-/var/tmp}/heft-try.XXXXXX")
machine=
trap '[ -z "$machine" ] || kill "$machine" 2>/dev/null; rm -rf --one-file-system "$work"' EXIT
trap 'exit 130' INT TERM
inside() {
    set -- "$@"
    [ -z "${PIP_CERT:-}" ] || set -- --bind-ro="$PIP_CERT" --setenv=PIP_CERT="$PIP_CERT" "$@"
    [ -z "${PIP_INDEX_URL:-}" ] || set -- --setenv=PIP_INDEX_URL="$PIP_INDEX_URL" "$@"
    systemd-nspawn -q -D "$work/root" --pipe --register=no --keep-unit --resolv-conf=replace-host "$@"
}
in_flight() { nsenter -t "$leader" -m -p -u -i -n "$@"; }
await_part() {    # NUMBER SECONDS: of the flight
    for second in $(seq "$2"); do
        sleep 1
        ! ls "$work/root/var/lib/heft/flights/"*"-001-part$1.mcap" 2>/dev/null || { echo "after $second s" && return 0; }
    done
    return 1
}
listing() {
    (cd "$work/root" && find . -xdev \( -path ./root -o -path ./proc -o -path ./sys -o -path ./dev -o -path ./run -o -path ./tmp \
        -o -path ./var/cache -o -path ./var/lib/apt -o -path ./var/lib/dpkg -o -path ./var/log -o -path ./usr \
        -o -path ./etc/alternatives -o -path './etc/python3*' -o -path './var/lib/python' \) -prune -o -print | LC_ALL=C sort)
}

note "a fresh Debian $suite"
mkdir "$work/root"
if [ -n "${HEFT_TRY_ROOT:-}" ] && [ -f "$HEFT_TRY_ROOT" ]; then
    tar -C "$work/root" -xf "$HEFT_TRY_ROOT"
else
    debootstrap --variant=minbase --include=systemd-sysv,dbus,udev,ca-certificates "$suite" "$work/root" >"$work/log" 2>&1 ||
        { tail -n 20 "$work/log" >&2; die 69 "debootstrap of $suite failed (see above)"; }
    [ -z "${HEFT_TRY_ROOT:-}" ] || tar -C "$work/root" -cf "$HEFT_TRY_ROOT" .
fi
mkdir "$work/root/root/heft"
tar -C "$root" --exclude=./.venv --exclude=./.git --exclude=__pycache__ --exclude='./.*_cache' --exclude=./flights -cf - . |
    tar -C "$work/root/root/heft" --no-same-owner -xf -
listing >"$work/before"

note 'a dry run changes nothing'
inside sh -c 'apt-get update -qq && apt-get install -yqq --no-install-recommends python3 >/dev/null'
listing >"$work/before"
inside sh /root/heft/deploy/install.sh --vehicle rocksat --dry-run
listing | cmp -s - "$work/before" || die 1 'the dry run changed files'

note 'install'
inside sh /root/heft/deploy/install.sh --vehicle rocksat
note 'install again'
inside sh /root/heft/deploy/install.sh | tee "$work/again"
[ "$(cat "$work/again")" = 'heft: nothing to change' ] || die 1 'the second run changed something'

note 'what was installed'
inside id heft
inside systemctl is-enabled heft.service systemd-networkd.service
inside systemd-analyze verify /etc/systemd/system/heft.service
inside systemd-analyze security --offline=true --no-pager --threshold=30 heft.service | tail -n 1
inside runuser -u heft -- /opt/heft/.venv/bin/heft --version
inside runuser -u heft -- sh -c '! touch /opt/heft/x 2>/dev/null && ! touch /etc/heft/x 2>/dev/null' ||
    die 1 'user heft can write what it flies from'

note 'a flight, as systemd starts it'
systemd-nspawn -q -D "$work/root" --register=no --keep-unit --boot --console=passive >"$work/boot" 2>&1 </dev/null &
machine=$!
leader=
for _ in $(seq 30); do
    sleep 1
    leader=$(pgrep -P "$machine" -o 2>/dev/null || :)
    [ -z "$leader" ] || ! ls "$work/root/var/lib/heft/flights/"*.mcap >/dev/null 2>&1 || break
done
if ls "$work/root/var/lib/heft/flights/"*.mcap >/dev/null 2>&1; then
    sleep "${HEFT_TRY_FLIGHT_S:-15}"    # its watchdog bites after 90 s; without devices it is armed after 10 s
    in_flight systemctl --no-pager status heft.service | head -n 15
    in_flight systemctl show -p ActiveState -p SubState -p NRestarts -p WatchdogUSec heft.service >"$work/shown"
    cat "$work/shown"
    [ "$(grep -c -e '^ActiveState=active$' -e '^SubState=running$' -e '^NRestarts=0$' "$work/shown")" = 3 ] ||
        die 1 'the service did not say that it is ready, or was started again'
    note 'everything is killed: systemd starts it again, and it goes on with the flight'
    in_flight systemctl kill --kill-whom=all --signal=KILL heft.service
    await_part 2 60 || die 1 'it did not go on with the flight'
    sleep 15    # it feeds the watchdog by then
    note 'its supervisor hangs: the watchdog of systemd starts it again, and it goes on with the flight'
    in_flight systemctl kill --kill-whom=main --signal=STOP heft.service
    await_part 3 150 || die 1 'the watchdog did not start it again'
    in_flight systemctl show -p NRestarts heft.service
    sleep 3
    in_flight systemctl stop heft.service
    in_flight journalctl --no-pager -u heft -n 25 || :
    in_flight systemctl poweroff || :
    wait "$machine" || :
    machine=
    for log in "$work/root/var/lib/heft/flights/"*-001.mcap "$work/root/var/lib/heft/flights/"*-part2.mcap; do
        inside runuser -u heft -- /opt/heft/.venv/bin/heft info "${log#"$work/root"}" | head -n 12
    done
else
    kill "$machine" 2>/dev/null || :
    wait "$machine" 2>/dev/null || :
    machine=
    tail -n 20 "$work/boot"
    echo 'not tried: this machine does not boot a container'
fi

note 'uninstall'
inside sh /root/heft/deploy/install.sh --uninstall --purge
listing >"$work/after"
diff "$work/before" "$work/after" | grep '^[<>]' >"$work/left" || :
cat "$work/left"    # the boot and the packages leave some
! grep -e '^<' -e heft -e sysusers -e journald "$work/left" || die 1 'the root is not as it was before (see above)'
note 'all held'
