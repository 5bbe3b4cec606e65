#!/bin/sh
# heft hil, from nothing: a whole mission against simulated devices, rocksat unless the first argument names another.
# Needs Python >= 3.11 with venv; installs the rest into .venv of this checkout, once. Arguments go to `heft hil`.
set -eu
root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
. "$root/deploy/env.sh"
heft_env hil
case ${1--} in -*) set -- rocksat "$@" ;; esac
exec "$heft_venv/bin/heft" hil "$@"
