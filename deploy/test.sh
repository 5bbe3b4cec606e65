#!/bin/sh
# The test suite, from nothing. Without arguments all of it but campaigns (-m campaign), as .ci/run does: on all cores, a
# file a process at a time, and beside them, before them in line for a core, the tests that run against the wall clock;
# then what the latter said, and one closing line of both. HEFT_REALTIME_OVER names a file to be made when those have
# ended.
# Arguments go to one pytest, which runs in the checkout's root: sh deploy/test.sh tests/drivers -k ring
set -eu
root=$(CDPATH='' cd -- "$(dirname -- "$0")/.." && pwd -P)
. "$root/deploy/env.sh"
heft_env test
cd "$root"
[ $# -eq 0 ] || exec "$heft_venv/bin/python" -m pytest "$@"

said=$(mktemp -d)
# also a part that was begun and whose number is not taken yet
trap 'trap "" INT TERM HUP PIPE; jobs -p >"$said/parts"; kill $(cat "$said/parts") 2>/dev/null || :; rm -rf "$said"' EXIT
trap 'exit 130' INT TERM HUP PIPE
code=0 began=$(date +%s)
tests() {    # a part, in the background; one that hangs beyond each test's own limit is ended, and has failed
    exec timeout --kill-after=60 3600 "$@"
}
python=$heft_venv/bin/python
timed=$(grep -rl --include='test_*.py' realtime tests | sort)    # only these are collected: a quarter of the time
tests "$python" -m pytest -m 'realtime and not campaign' --numprocesses auto --dist worksteal $timed >"$said/realtime" &
beside=$!
printf '\n-- all cores, and beside them in real time\n'
mkfifo "$said/shown"
tee "$said/cores" <"$said/shown" &
shown=$!
tests nice -n 10 "$python" -m pytest -m 'not realtime and not campaign' --numprocesses auto --dist loadfile \
    --no-loadscope-reorder >"$said/shown" &
most=$!
wait "$beside" || echo $? >"$said/code"    # a signal ends a wait, and no pipe
[ -z "${HEFT_REALTIME_OVER:-}" ] || : >"$HEFT_REALTIME_OVER"
wait "$most" || echo $? >"$said/code"
wait "$shown"
printf '\n-- real time\n'
cat "$said/realtime"
tail -qn 1 "$said/cores" "$said/realtime" >"$said/last"
[ ! -f "$said/code" ] || code=$(cat "$said/code")

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
