#!/bin/sh
# The test suite, from nothing. Without arguments all of it, as .ci/run does: on all cores, a file a process at a time; then
# the tests that run against the wall clock, one a core, for they mostly wait; then one closing line of both.
# Arguments go to one pytest, which runs in the checkout's root: sh deploy/test.sh tests/drivers -k ring
set -eu
root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
. "$root/deploy/env.sh"
heft_env test
cd "$root"
[ $# -eq 0 ] || exec "$heft_venv/bin/python" -m pytest "$@"

said=$(mktemp -d)
trap 'rm -rf "$said"' EXIT
code=0 began=$(date +%s)
longest=2400    # seconds: a part that hangs beyond each test's own limit is ended, and has failed
part() {    # name, and arguments of pytest; its last line is kept
    name=$1
    shift
    printf '\n-- %s\n' "$name"
    { timeout --kill-after=60 "$longest" "$heft_venv/bin/python" -m pytest "$@" || echo $? >"$said/code"; } | tee "$said/$name"
    tail -n 1 "$said/$name" >>"$said/last"
    [ ! -f "$said/code" ] || code=$(cat "$said/code")
}
part 'all cores' -m 'not realtime' --numprocesses auto --dist loadfile --no-loadscope-reorder
timed=$(grep -rl --include='test_*.py' realtime tests | sort)    # only these are collected: a quarter of the time
part 'real time' -m realtime --numprocesses auto --dist worksteal $timed

# Counts of both, in pytest's own words: 1 failed, 4731 passed, 2 skipped in 655.20s
awk '
{
    sub(/ in [0-9.]+s.*/, "")
    gsub(/[=,]/, " ")
    for (i = 1; i < NF; i++) if ($i ~ /^[0-9]+$/ && $(i + 1) != "deselected") count[$(i + 1)] += $i
}
END {
    split("failed errors error passed skipped xfailed xpassed warnings warning", words, " ")
    for (i = 1; i in words; i++) if (words[i] in count) { line = line comma count[words[i]] " " words[i]; comma = ", " }
    print (line == "" ? "no tests ran" : line)
}' "$said/last" >"$said/counts"
printf '\n'
cat "$said/last"
printf 'heft: %s in %s s\n' "$(cat "$said/counts")" "$(($(date +%s) - began))"
exit "$code"
