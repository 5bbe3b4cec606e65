"""A flight whose estimator gets a quarter of the CPU that it needs: what is left out, what is lost, what it answers.

    python -m bench.overload [--vehicle rocksat] [--share 0.25] [--seconds 22]

The estimator's need is measured for ten seconds of the flight; from then on its process is stopped and continued
(SIGSTOP, SIGCONT, four times a second), so that it has ``--share`` of that. At the end of the flight it may finish.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from bench.restarts import processes, start
from onboard import config
from onboard.offline.estimate_again.replay import replay
from onboard.recording.reader import LogReader

PERIOD_S = 0.25
MEASURED_S = 10.0


def cpu_s(pid: int) -> float:
    """CPU time that a process has had."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


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


def main() -> None:
    """Print what came of it."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--vehicle", default="rocksat")
    parser.add_argument("--share", type=float, default=0.25)
    parser.add_argument("--seconds", type=float, default=22.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place, ExitStack() as stack:
        log = Path(place) / "overload.mcap"
        serve = [sys.executable, "-m", "hil_sim.serve", options.vehicle, "--seed", "3", "--directory", place]
        devices = stack.enter_context(subprocess.Popen(serve, stdout=subprocess.PIPE, text=True))
        stack.callback(devices.terminate)
        assert devices.stdout is not None
        served = json.loads(devices.stdout.readline())
        urls = [f"--url={bus}={served[bus]}" for bus in config.named(options.vehicle).buses if bus in served]
        flight = start(options.vehicle, log, urls, 0)
        stack.callback(flight.wait)
        stack.callback(flight.kill)
        while not (log.exists() and "heft-estimate" in processes(flight.pid)):
            time.sleep(0.1)
        time.sleep(2.0)
        need, got, restarts = starve(flight.pid, options.share, options.seconds)
        flight.send_signal(signal.SIGTERM)
        flight.wait(120)
        print(f"needs {need:.0%} of a core, got {got:.1%}; restarts {restarts}; exit {flight.returncode}")
        read = LogReader(log)
        ticks, events, answers = read.read("tick"), read.read("event_estimation"), read.read("quantity")
        for code in (
            b"estimator_late",
            b"estimator_thins",
            b"estimator_skips",
            b"estimator_whole",
            b"estimator_overrun",
        ):
            said = [row["text"].decode() for row in events if row["code"] == code]
            print(f"{code.decode()}: {len(said)}" + (f"; last: {said[-1]}" if said else ""))
        lost = len(read.read("recorder_gap"))
        print(f"left out {1e-9 * ticks['skipped_ns'].sum():.1f} s; gaps of the recorder: {lost}")
        last = answers[answers["host_ns"] == answers["host_ns"][-1]]
        for row in last[(last["supported"] == 1) & (last["unit"] != b"")][:3]:
            value = f"{row['value']:.4g} {row['unit'].decode()}"
            print(f"{row['name'].decode()} {value} ({row['low']:.4g} to {row['high']:.4g})")
        print("replay:", replay(log).summary)


if __name__ == "__main__":
    main()
