"""A flight whose estimator gets a quarter of the CPU that it needs: what is left out, what is lost, what it answers.

    python -m bench.overload [--vehicle rocksat] [--share 0.25] [--seconds 48]

The estimator's need is measured for ten seconds of the flight; from then on its process is stopped and continued
(SIGSTOP, SIGCONT, four times a second), so that it has ``--share`` of that. At the end of the flight it may finish.

Bars (exit code 1 where one is missed): no restart, no row lost by the recorder, none missing without a gap record, an
answer at the end, the replay identical to the bit.
"""

import argparse
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

from bench import given
from bench.real_flight import cpu_s, flying, processes
from onboard.ground.identify.replay.replay import replay
from onboard.ground.log.views.info import info
from onboard.recording.reader import LogReader

PERIOD_S = 0.25
MEASURED_S = 10.0


def starve(supervisor: int, share: float, seconds: float) -> tuple[float, float, int]:
    """Let the estimator have ``share`` of the CPU that it used before; need, what it got (cores), and restarts."""
    pid = processes(supervisor)["heft-estimate"]
    before_s = cpu_s(pid)
    time.sleep(MEASURED_S)
    need = (cpu_s(pid) - before_s) / MEASURED_S
    end_s, restarts, got_s = time.monotonic() + seconds, 0, 0.0
    while time.monotonic() < end_s:
        now = processes(supervisor).get("heft-estimate")
        if now is None:
            time.sleep(0.01)
            continue
        restarts += now != pid
        pid = now
        os.kill(pid, signal.SIGCONT)
        began_s, had_s = time.monotonic(), cpu_s(pid)
        while cpu_s(pid) - had_s < share * need * PERIOD_S and time.monotonic() - began_s < PERIOD_S:
            time.sleep(0.002)
        got_s += cpu_s(pid) - had_s
        os.kill(pid, signal.SIGSTOP)
        time.sleep(max(0.0, PERIOD_S - (time.monotonic() - began_s)))
    os.kill(pid, signal.SIGCONT)
    return need, got_s / seconds, restarts


def main() -> int:
    """Print what came of it, and the bars missed."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--vehicle", type=given.vehicle, default="rocksat")
    parser.add_argument("--share", type=float, default=0.25)
    parser.add_argument("--seconds", type=float, default=48.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        with flying(options.vehicle, Path(place), name="overload") as flight:
            log = flight.log
            time.sleep(2.0)
            need, got, restarts = starve(flight.process.pid, options.share, options.seconds)
            code = flight.end()
        print(f"needs {need:.0%} of a core, got {got:.1%}; restarts {restarts}; exit {code}")
        read = LogReader(log)
        ticks, events, answers = read.read("tick"), read.read("event_estimation"), read.read("quantity")
        for kind in (b"estimator_late", b"estimator_skips", b"estimator_overrun"):
            said = [row["text"].decode() for row in events if row["code"] == kind]
            print(f"{kind.decode()}: {len(said)}" + (f"; last: {said[-1]}" if said else ""))
        lost = len(read.read("recorder_gap"))
        print(f"left out {1e-9 * ticks['skipped_ns'].sum():.1f} s; gaps of the recorder: {lost}")
        last = answers[answers["host_ns"] == answers["host_ns"][-1]]
        answered = last[(last["supported"] == 1) & (last["unit"] != b"")]
        for row in answered[:3]:
            value = f"{row['value']:.4g} {row['unit'].decode()}"
            print(f"{row['name'].decode()} {value} ({row['low']:.4g} to {row['high']:.4g})")
        again, unexplained = replay(log), info(log).unexplained
        print("replay:", again.summary)
    counts = {"restarts": restarts, "gaps of the recorder": lost, "rows in no gap": unexplained}
    missed = [f"{count} {what}" for what, count in counts.items() if count]
    missed += [] if len(answered) else ["no answer at the end"]
    missed += [] if again.identical else ["the replay differs"]
    for text in missed:
        print(f"MISSED {text}")
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
