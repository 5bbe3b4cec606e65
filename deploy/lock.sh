#!/bin/sh
# Writes deploy/requirements.lock and deploy/requirements-test.lock from pyproject.toml: every package at one version, for
# Python 3.11 and newer, with the hashes of all its files; and deploy/requirements-compiler.lock, the C compiler for a
# system without one, from onboard/native/build.py. Pins stay where they still fit; arguments go to `uv pip compile`:
#   sh deploy/lock.sh                             after a change of dependencies in pyproject.toml
#   sh deploy/lock.sh --upgrade                   everything to its newest version
#   sh deploy/lock.sh --upgrade-package numpy     one package
set -eu
root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
. "$root/deploy/env.sh"
heft_find_python
heft_check_system
cd "$root"
tools=$(mktemp -d)
trap 'rm -rf "$tools"' EXIT
"$heft_python" -m venv "$tools"
"$tools/bin/python" -m pip install --quiet 'uv>=0.5,<1'

compile() {
    extra=$1 lock=$2
    shift 2
    # The editable install builds without isolation, so the build backend is locked with the rest.
    "$tools/bin/python" -c '
import tomllib
with open("pyproject.toml", "rb") as file:
    print(*tomllib.load(file)["build-system"]["requires"], sep="\n")
' | "$tools/bin/uv" pip compile pyproject.toml - --extra "$extra" --output-file "$lock" \
        --universal --python-version 3.11 --fork-strategy fewest --generate-hashes \
        --only-binary :all: --no-config --no-annotate --custom-compile-command 'sh deploy/lock.sh' --quiet "$@"
    printf '%s: %s packages\n' "$lock" "$(grep -c '==' "$lock")"
}

compile hil deploy/requirements.lock "$@"
compile test deploy/requirements-test.lock --constraint deploy/requirements.lock "$@"
sed -n 's/^ZIG = "\(.*\)".*/\1/p' onboard/native/build.py | "$tools/bin/uv" pip compile - --output-file deploy/requirements-compiler.lock \
    --universal --python-version 3.11 --generate-hashes --only-binary :all: --no-config --no-annotate \
    --custom-compile-command 'sh deploy/lock.sh' --quiet
