#!/bin/sh
# Makes this computer a flight computer: Debian 12, 13 or Raspberry Pi OS, 64-bit, with systemd. Run as root, as often as
# you like: what is there already stays as it is.
#
#   sh deploy/install.sh --vehicle NAME|FILE    a packaged vehicle, or your vehicle.toml with its URDF beside it; needed
#                                               the first time, and never replaces /etc/heft/vehicle.toml
#       [--mcp2515 OSCILLATOR:PIN]              CAN board on SPI: crystal, Hz, and interrupt pin (Raspberry Pi only)
#       [--name NAME=/dev/ttyUSB0]              /dev/heft/NAME for the adapter that is plugged in there (repeatable)
#       [--dry-run]                             say what would be done, and do nothing
#   sh deploy/install.sh --uninstall [--purge]  take it all away; --purge: flights and vehicle file too
#
# What it makes: packages that are missing, by apt; user heft, without a shell; this checkout in /opt/heft, owned by root,
# with the environment that deploy/requirements.lock pins; /etc/heft/vehicle.toml; the units, device rules, CAN interfaces
# and limits listed in `files` below. Which interfaces those are is read from the vehicle file. deploy/README.md says what
# it leaves to you: clock, power, partitions.
#
# Exit codes: 0 done; 64 arguments; 65 the vehicle file cannot be flown; 69 not this system; 75 an installation broke off
# (run it again); 77 not root; 78 a flight is under way.
set -eu
root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
# shellcheck source=deploy/env.sh
. "$root/deploy/env.sh"

prefix=/opt/heft
vehicle_file=/etc/heft/vehicle.toml
marks=/etc/heft/.installed    # what was not there before, so that --uninstall takes it away
files='/etc/systemd/system/heft.service /etc/sysusers.d/heft.conf /etc/udev/rules.d/60-heft.rules
/etc/udev/rules.d/61-heft-names.rules /etc/sysctl.d/60-heft.conf /etc/modules-load.d/heft.conf
/etc/tmpfiles.d/heft.conf /etc/systemd/journald.conf.d/60-heft.conf'
begin='# heft: begin (deploy/install.sh)'
end='# heft: end'

dry=''
tally=$(mktemp)    # a line for each change: also those made in a pipe
trap 'rm -f "$tally"' EXIT
say() { printf 'heft: %s\n' "$*"; }

# Runs a command, or says it.
run() {
    echo >>"$tally"
    say "${dry:+would run: }$*"
    [ -n "$dry" ] || "$@" || heft_die 75 "that failed (see above). Run the same command again; what is done stays."
}

# Writes standard input to a file, if it is not that already.
put() {
    put_new=$(cat)
    if [ -f "$1" ] && [ "$(cat "$1")" = "$put_new" ]; then
        return 0
    fi
    echo >>"$tally"
    say "${dry:+would }write $1"
    [ -z "$dry" ] || return 0
    mkdir -p "$(dirname -- "$1")"
    printf '%s\n' "$put_new" >"$1.heft-new"
    chmod 0644 "$1.heft-new"
    mv "$1.heft-new" "$1"
}

remove() {
    for remove_path in "$@"; do
        if [ -e "$remove_path" ] || [ -L "$remove_path" ]; then
            run rm -rf -- "$remove_path"
        fi
    done
}

mark() { [ -n "$dry" ] || { mkdir -p "$marks" && : >"$marks/$1"; }; }
is_running() { [ -d /run/systemd/system ]; }    # systemd, here; not in a chroot

boot_config() {
    for boot in /boot/firmware/config.txt /boot/config.txt; do
        [ ! -f "$boot" ] || { printf %s "$boot" && return; }
    done
}

# The lines on standard input become our part of config.txt; none: our part goes.
set_overlays() {
    boot=$(boot_config)
    lines=$(cat)
    [ -n "$boot" ] || return 0
    others=$(sed "/^$begin/,/^$end/d" "$boot")
    if [ -z "$lines" ] && ! grep -q "^$begin" "$boot"; then
        return 0
    fi
    if [ -n "$lines" ]; then
        printf '%s\n%s\n[all]\n%s\n%s\n' "$others" "$begin" "$lines" "$end" | put "$boot"
    else
        printf '%s\n' "$others" | put "$boot"
    fi
}

# What a vehicle file needs of the system, one thing a line.
needs_of() {
    "$heft_python" -c '
import re, sys, tomllib
from urllib.parse import parse_qs, urlsplit

try:
    with open(sys.argv[1], "rb") as file:
        tables = tomllib.load(file)
    print("urdf", tables["vehicle"]["urdf"])
    for bus in tables.get("bus", {}).values():
        parts = urlsplit(bus["url"])
        if parts.scheme == "can+socketcan" and not parts.netloc.startswith("vcan"):
            bitrate = parse_qs(parts.query).get("bitrate", ["500000"])[0]
            if not re.fullmatch("[a-z][a-z0-9_]{0,14} [0-9]{4,8}", f"{parts.netloc} {bitrate}"):
                sys.exit(f"{parts.netloc} at {bitrate} bit/s is no CAN interface")
            print("can", parts.netloc, bitrate)
        elif parts.scheme in ("i2c", "gpio"):
            print(parts.scheme)
except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
    sys.exit(f"{type(error).__name__}: {error}")
' "$1" || heft_die 65 "$1 cannot be flown (see above): correct it."
}

uninstall() {
    if is_running && [ -e /etc/systemd/system/heft.service ]; then
        run systemctl disable --now heft.service
    else
        remove /etc/systemd/system/multi-user.target.wants/heft.service
    fi
    if [ -e "$marks/networkd" ]; then
        run systemctl disable systemd-networkd.service
    fi
    # shellcheck disable=SC2086
    remove $files /etc/systemd/network/60-heft-*.network /etc/systemd/network/60-heft-*.link
    set_overlays </dev/null
    for directory in /etc/sysusers.d /etc/systemd/journald.conf.d; do
        [ -n "$dry" ] || rmdir --ignore-fail-on-non-empty "$directory" 2>/dev/null || :
    done
    remove "$prefix"
    if id heft >/dev/null 2>&1; then
        run userdel heft
    fi
    for group in i2c gpio heft; do
        if [ -e "$marks/group-$group" ] && getent group "$group" >/dev/null; then
            run groupdel "$group"
        fi
    done
    remove "$marks"
    if [ -n "$purge" ]; then
        remove /var/lib/heft /etc/heft
    else
        say 'flights in /var/lib/heft and the vehicle file in /etc/heft stay; --purge removes them'
    fi
    ! is_running || run systemctl daemon-reload
    say 'packages that apt installed stay'
}

install_packages() {
    missing=
    for package in python3 python3-venv libgomp1 udev i2c-tools can-utils gpiod; do
        dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing="$missing $package"
    done
    [ -n "$missing" ] || return 0
    export DEBIAN_FRONTEND=noninteractive
    # shellcheck disable=SC2086
    apt-get install -yqq --no-install-recommends --dry-run $missing >/dev/null 2>&1 || run apt-get update -q
    # shellcheck disable=SC2086
    run apt-get install -yq --no-install-recommends $missing
}

install_user() {
    for group in i2c gpio heft; do
        getent group "$group" >/dev/null || mark "group-$group"
    done
    put /etc/sysusers.d/heft.conf <<END
g i2c - -
g gpio - -
u heft - "heft flight computer" /var/lib/heft
m heft i2c
m heft gpio
m heft dialout
END
    for group in i2c gpio dialout; do
        id -nG heft 2>/dev/null | grep -qw "$group" || { run systemd-sysusers /etc/sysusers.d/heft.conf && return; }
    done
}

# This checkout, as it is, without what a working copy collects.
install_code() {
    if [ "$root" != "$prefix" ]; then
        new=$(cd "$root" && find . -path ./.venv -prune -o -name __pycache__ -prune -o -path ./flights -prune \
            -o -path './.*_cache' -prune -o -path ./.git -prune -o -type f -print | LC_ALL=C sort | tr '\n' '\0' |
            xargs -0 sha256sum | sha256sum)
        revision=$(git -C "$root" rev-parse HEAD 2>/dev/null || :)
        if [ "$(cat "$prefix/.copied" 2>/dev/null)" != "$new $revision" ]; then
            echo >>"$tally"
            say "${dry:+would }copy $root to $prefix"
            if [ -z "$dry" ]; then
                mkdir -p "$prefix"
                find "$prefix" -mindepth 1 -maxdepth 1 ! -name .venv -exec rm -rf {} +
                tar -C "$root" --exclude=./.venv --exclude=__pycache__ --exclude=./flights --exclude='./.*_cache' \
                    -cf - . | tar -C "$prefix" --no-same-owner -xf -
                chmod -R u=rwX,go=rX "$prefix"
                printf '%s' "$new $revision" >"$prefix/.copied"
            fi
        fi
    fi
    [ -z "$dry" ] || { say "would install the environment into $prefix/.venv" && return; }
    before=$(cat "$prefix/.venv/heft-hil" 2>/dev/null || :)
    sh -c 'set -eu; umask 022; root=$1; . "$1/deploy/env.sh"; heft_env hil' sh "$prefix" || exit
    if [ "$before" != "$(cat "$prefix/.venv/heft-hil")" ]; then
        echo >>"$tally"
    fi
    "$prefix/.venv/bin/python" -m compileall -q "$prefix/drivers" "$prefix/onboard" "$prefix/hil_sim" "$prefix/heft"
}

install_vehicle() {
    if [ -f "$vehicle_file" ]; then
        [ -z "$vehicle" ] || say "$vehicle_file stays as it is; remove it to install another"
        source=$vehicle_file
        return
    fi
    case $vehicle in
        '') heft_die 64 "which vehicle? --vehicle NAME or FILE; packaged are: $(cd "$root/onboard/vehicles" && echo *)" ;;
        *.toml) source=$vehicle ;;
        *) source=$root/onboard/vehicles/$vehicle/vehicle.toml ;;
    esac
    [ -f "$source" ] || heft_die 64 "there is no $source; packaged are: $(cd "$root/onboard/vehicles" && echo *)"
    needs=$(needs_of "$source")
    urdf=$(printf '%s\n' "$needs" | sed -n 's/^urdf //p')
    case $urdf in
        '' | */* | .*) heft_die 65 "$source names no URDF beside it" ;;
    esac
    [ -f "$(dirname -- "$source")/$urdf" ] || heft_die 65 "$source names $urdf, which is not beside it"
    put "/etc/heft/$urdf" <"$(dirname -- "$source")/$urdf"
    put "$vehicle_file" <"$source"
}

install_system() {
    needs=$(needs_of "$source")
    put /etc/systemd/system/heft.service <"$root/deploy/heft.service"
    put /etc/udev/rules.d/60-heft.rules <<'END'
# Devices of a flight are for their groups, of which user heft is one.
SUBSYSTEM=="i2c-dev", GROUP="i2c", MODE="0660"
SUBSYSTEM=="gpio", KERNEL=="gpiochip*", GROUP="gpio", MODE="0660"
SUBSYSTEM=="pps", GROUP="dialout", MODE="0660"
# FTDI adapters keep bytes for 16 ms, unless they are told not to.
ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"
END
    if [ -n "$names" ]; then
        { [ ! -f /etc/udev/rules.d/61-heft-names.rules ] || cat /etc/udev/rules.d/61-heft-names.rules
          printf '%s' "$names"; } | awk '!seen[$0]++' | put /etc/udev/rules.d/61-heft-names.rules
    fi
    put /etc/sysctl.d/60-heft.conf <<'END'
# CAN sockets ask for so much, so that no frame is lost while the computer is busy.
net.core.rmem_max = 4194304
END
    put /etc/tmpfiles.d/heft.conf <<'END'
# The processor's clock stays up: a slow start costs milliseconds in every tick.
w- /sys/devices/system/cpu/cpufreq/policy*/scaling_governor - - - - performance
# Flights are for their user alone.
d /var/lib/heft 0700 heft heft
END
    [ -d /var/lib/heft ] || run systemd-tmpfiles --create /etc/tmpfiles.d/heft.conf
    put /etc/systemd/journald.conf.d/60-heft.conf <<'END'
# The journal never takes the room of flights, and goes to the disk at once when something is wrong.
[Journal]
SystemMaxUse=200M
SystemKeepFree=1G
RuntimeMaxUse=50M
SyncIntervalSec=10s
END
    overlays=
    case $needs in
        *i2c*)
            printf 'i2c-dev\n' | put /etc/modules-load.d/heft.conf
            overlays='dtparam=i2c_arm=on,i2c_arm_baudrate=400000' ;;    # 100 kHz cannot carry 1,000 samples a second
    esac
    if [ -n "$mcp2515" ]; then
        overlays="$overlays
dtparam=spi=on
dtoverlay=mcp2515-can0,oscillator=${mcp2515%:*},interrupt=${mcp2515#*:}"
    fi
    if [ -n "$(boot_config)" ]; then
        # the overlay of a CAN board stays when a later run does not name it
        if [ -z "$mcp2515" ]; then
            overlays="$overlays
$(sed -n "/^$begin/,/^$end/p" "$(boot_config)" | grep -e '^dtparam=spi' -e '^dtoverlay=mcp2515' || :)"
        fi
        printf '%s\n' "$overlays" | sed '/^$/d' | set_overlays
    fi
    printf '%s\n' "$needs" | while read -r kind interface bitrate; do
        [ "$kind" = can ] || continue
        put "/etc/systemd/network/60-heft-$interface.network" <<END
[Match]
Name=$interface

[Link]
RequiredForOnline=no

[CAN]
BitRate=$bitrate
RestartSec=100ms
END
        put "/etc/systemd/network/60-heft-$interface.link" <<END
[Match]
OriginalName=$interface

[Link]
NamePolicy=keep
TransmitQueueLength=1000
END
    done
    case $needs in
        *can*)
            if ! systemctl is-enabled -q systemd-networkd.service 2>/dev/null; then
                mark networkd
                run systemctl enable systemd-networkd.service
                # it waits for networks at boot, of which networkd has none here but CAN
                run systemctl disable systemd-networkd-wait-online.service
            fi ;;
    esac
    systemctl is-enabled -q heft.service 2>/dev/null || run systemctl enable heft.service
}

# What the running system takes up without a restart.
reload() {
    { [ -s "$tally" ] && is_running; } || return 0
    run systemctl daemon-reload
    run udevadm control --reload
    run udevadm trigger --subsystem-match=i2c-dev --subsystem-match=gpio --subsystem-match=tty
    run sysctl -q -p /etc/sysctl.d/60-heft.conf
    run systemctl restart systemd-journald.service
    case $needs in
        *can*) run systemctl restart systemd-networkd.service ;;
    esac
}

name_rule() {
    name=${1%%=*} device=${1#*=}
    case $name in
        '' | *[!a-z0-9_]*) heft_die 64 "--name $1: write NAME=/dev/ttyUSB0, the name in small letters, digits and _" ;;
    esac
    properties=$(udevadm info --query=property --name="$device" 2>/dev/null) ||
        heft_die 64 "--name $1: no device $device; plug the adapter in first"
    value() { printf '%s\n' "$properties" | sed -n "s/^$1=\([A-Za-z0-9_.:-]*\)\$/\1/p"; }
    [ -n "$(value ID_VENDOR_ID)" ] || heft_die 64 "--name $1: $device is no USB adapter; its name is fixed already"
    rule="SUBSYSTEM==\"tty\", ENV{ID_VENDOR_ID}==\"$(value ID_VENDOR_ID)\", ENV{ID_MODEL_ID}==\"$(value ID_MODEL_ID)\""
    serial=$(value ID_SERIAL_SHORT)
    if [ -n "$serial" ]; then
        rule="$rule, ENV{ID_SERIAL_SHORT}==\"$serial\""
    else
        rule="$rule, ENV{ID_PATH}==\"$(value ID_PATH)\""    # adapters without a number are told by their socket
    fi
    printf '%s\n' "$rule, SYMLINK+=\"heft/$name\""
}

vehicle='' mcp2515='' names='' purge='' action=install
while [ $# -gt 0 ]; do
    case $1 in
        --vehicle | --mcp2515 | --name)
            [ $# -gt 1 ] || heft_die 64 "$1 needs a value"
            case $1 in
                --vehicle) vehicle=$2 ;;
                --mcp2515) mcp2515=$2 ;;
                --name) names="$names$(name_rule "$2")
" ;;
            esac
            shift ;;
        --dry-run) dry=1 ;;
        --uninstall) action=uninstall ;;
        --purge) purge=1 ;;
        *) heft_die 64 "unknown argument $1; the head of deploy/install.sh lists them" ;;
    esac
    shift
done
case $mcp2515 in
    '') ;;
    *[!0-9:]* | *:*:* | :* | *: ) heft_die 64 "--mcp2515 $mcp2515: write OSCILLATOR:PIN, e.g. 16000000:25" ;;
    *:*) [ -n "$(boot_config)" ] || heft_die 69 '--mcp2515 is for a Raspberry Pi: this computer has no config.txt' ;;
    *) heft_die 64 "--mcp2515 $mcp2515: write OSCILLATOR:PIN, e.g. 16000000:25" ;;
esac
[ -n "$dry" ] || [ "$(id -u)" = 0 ] || heft_die 77 "run it as root: sudo sh $0"
for tool in systemctl apt-get runuser; do
    command -v "$tool" >/dev/null 2>&1 ||
        heft_die 69 "this system has no $tool: Debian 12, 13 or Raspberry Pi OS with systemd is needed"
done
if is_running && systemctl is-active -q heft.service && [ -z "$dry" ] && [ $action = install ]; then
    heft_die 78 'a flight is under way: sudo systemctl stop heft, then run this again'
fi
if [ $action = uninstall ]; then
    uninstall
    exit 0
fi
install_packages
heft_find_python
install_vehicle
install_user
install_code
if [ -z "$dry" ]; then
    runuser -u heft -- "$prefix/.venv/bin/python" -c '
import pathlib, sys
from onboard import config
from onboard.flight.estimate.estimator import Estimator
try:
    Estimator(config.load(pathlib.Path(sys.argv[1])))
except (ValueError, LookupError) as error:
    sys.exit(f"heft: {error}")
' "$vehicle_file" || heft_die 65 "$vehicle_file cannot be flown (see above): correct it, then run this again"
fi
install_system
reload
if [ ! -s "$tally" ]; then
    say 'nothing to change'
else
    say "${dry:+would be }installed. Check the vehicle: sudo -u heft env -C /var/lib/heft $prefix/.venv/bin/heft preflight $vehicle_file"
    say 'then fly: sudo systemctl start heft; it also starts at boot. Left to you, see deploy/README.md: clock, partitions'
fi
