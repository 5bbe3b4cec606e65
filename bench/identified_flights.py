"""``heft identify`` of simulated free flights beside the onboard answer in their logs: errors, sigmas, CPU time.

Run ``python -m bench.identified_flights LOG ...`` with logs of ``heft hil dymaflex --seed N --log LOG``, beside which
their truth is (LOG.truth.json). A line a log for the mass; then, per quantity over all logs and for both answers, rms
error, rms of the error in sigmas, the mean ratio of the sigmas, and how many truths lie inside the 95 % intervals.
"""

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from bench import given
from onboard.ground.identify.identify import identify
from onboard.ground.log.tables.vehicle_file import vehicle_of
from onboard.recording.reader import LogReader

NORMAL = 1.960  # half a 95 % interval, sigmas


def onboard(log: LogReader) -> dict[str, tuple[float, float]]:
    """Value and sigma of each quantity in the last onboard answer."""
    found = {}
    for _, rows in log.batches(["quantity"]):
        for row in rows[rows["supported"] != 0]:
            found[row["name"].decode()] = float(row["value"]), float(row["sigma"])
    return found


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="+", type=given.flown_log)
    errors: dict[str, list[tuple[float, float, float, float]]] = {}
    for path in parser.parse_args().logs:
        log = LogReader(path)
        truth = json.loads(Path(f"{path}.truth.json").read_text())["quantities"]
        flown = onboard(log)
        with tempfile.TemporaryDirectory() as directory:
            vehicle = vehicle_of(log, Path(directory))
            begun_s = time.process_time()
            (found,) = identify(vehicle, [path]).logs
        cpu_s = time.process_time() - begun_s
        for one in found.answers:
            if one.supported and one.name in flown and one.name in truth:
                value, sigma = flown[one.name]
                errors.setdefault(one.name, []).append(
                    (one.value - truth[one.name], one.sigma, value - truth[one.name], sigma)
                )
        name, rows = next(iter(errors.items()), ("", []))
        pairs = (rows[-1][:2], rows[-1][2:]) if rows else ()
        numbers = [f"{off:+.4f} +- {sigma:.4f}" for off, sigma in pairs]
        own = ", onboard ".join(numbers) or "no answer"
        print(f"{path.name:16}{name} {own}; {found.verdict.level}; {cpu_s:.1f} s of CPU", flush=True)
    print(f"{'':14}{'rms error':>22}{'rms in sigmas':>18}{'sigma':>9}{'inside 95 %':>16}")
    print(
        f"{'':14}{'identify':>11}{'onboard':>11}{'identify':>10}{'onboard':>8}{'ratio':>9}{'identify':>10}{'onboard':>8}"
    )
    for name, rows in errors.items():
        off, sigma, flown_off, flown_sigma = np.array(rows).T
        z, flown_z = off / sigma, flown_off / flown_sigma
        inside, flown_inside = (np.mean(np.abs(one) < NORMAL) for one in (z, flown_z))
        print(
            f"{name:14}{_rms(off):11.5f}{_rms(flown_off):11.5f}{_rms(z):10.2f}{_rms(flown_z):8.2f}"
            f"{np.mean(sigma / flown_sigma):9.3f}{inside:10.0%}{flown_inside:8.0%}"
        )


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


if __name__ == "__main__":
    main()
