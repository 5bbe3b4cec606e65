#!/bin/sh
# The whole test suite, from nothing. Arguments go to pytest, which runs in the checkout's root.
set -eu
root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
. "$root/deploy/env.sh"
heft_env test
cd "$root"
exec "$heft_venv/bin/python" -m pytest "$@"
