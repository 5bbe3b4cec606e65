#!/bin/sh
# heft hil rocksat, from nothing: the whole suborbital mission against simulated devices.
# Needs Python >= 3.11 with venv; installs the rest into .venv of this checkout, once. Arguments go to `heft hil rocksat`.
set -eu
root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
. "$root/deploy/env.sh"
heft_env hil
exec "$heft_venv/bin/heft" hil rocksat "$@"
