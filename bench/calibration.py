"""What calibration is worth, against simulated benches: ``python bench/calibration.py WHAT --first 1 --seeds 50``.

``bifilar``: the inertia of DYMAFLEX's base by swings, error of each element and how often its interval holds it.
``imu``: a datasheet part (3 % of scale, 2 % of cross-axis sensitivity) on DYMAFLEX, the payload's mass before and after
``heft calibrate imu``; the same seed draws the same chip for bench and flight.
``cells``: scale and offset of the load cell, zero of an encoder, mass and centre by balance.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hil_sim.bench import LATITUDE_deg, open_bench
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import open_in_process
from hil_sim.scenario.load import Scenario
from onboard import config
from onboard.estimation.calibration.bifilar import Suspension
from onboard.flight import bench, hil
from onboard.ground.calibrate import vehicle_file
from onboard.ground.calibrate.bifilar import calibrate_bifilar
from onboard.ground.calibrate.imu import ImuOptions, calibrate_imu
from onboard.ground.calibrate.load_cell import Masses, calibrate_load_cell
from onboard.ground.calibrate.place import place
from onboard.ground.calibrate.readings import readings
from onboard.ground.identify.mission import mission_table
from onboard.recording.reader import LogReader

DATASHEET = {
    "accel_g": {"scale_sigma": 0.015, "cross_axis_sigma": 0.01},
    "gyro_deg_s": {"scale_sigma": 0.015, "cross_axis_sigma": 0.01},
}
UNCALIBRATED = (  # the vehicle file of who has the datasheet only
    ("gyro_scale = 0.003", "gyro_scale = 0.015"),
    ("accelerometer_scale = 0.003", "accelerometer_scale = 0.015"),
    ("gyro_misalignment_rad = 8.7e-3", "gyro_misalignment_rad = 1.3e-2"),
    ("accelerometer_misalignment_rad = 8.7e-3", "accelerometer_misalignment_rad = 1.3e-2"),
)
SLOWER = (("sample_rate_hz = 1000", "sample_rate_hz = 200"), ("poll_period_ms = 20", "poll_period_ms = 50"))
PLACE = place(LATITUDE_deg)


def vehicle_with(*changes: tuple[str, str]) -> config.Vehicle:
    """DYMAFLEX with some texts of its file replaced, each once at least."""
    path = config.packaged("dymaflex")
    text = path.read_text(encoding="utf-8")
    for old, new in changes:
        if old not in text:
            raise ValueError(f"{old!r} is not in {path}")
        text = text.replace(old, new)
    return config.parse(text, path)


def record(
    what: str, vehicle: config.Vehicle, scenario: Scenario, seed: int, device: str, settings: dict[str, Any], log: Path
) -> dict[str, Any]:
    """A bench run to a log; its truth."""
    world, urls = open_bench(what, scenario, seed, {device}, settings)
    with world:
        bench.record_simulated(bench.only(vehicle, {device}).with_urls(urls), world, log, lambda _: None)
        return world.truth()


def bifilar(seed: int, directory: Path) -> dict[str, Any]:
    """Errors of the six elements against their sigmas, and relative to half the trace and to the moment."""
    vehicle, log = vehicle_with(*SLOWER), directory / "swings.mcap"
    settings = {"spacing_m": 0.40, "length_m": 1.80}
    truth = record("bifilar", vehicle, scenario_of("dymaflex"), seed, "imu_base", settings, log)
    hung = Suspension(round(truth["weighed_kg"], 3), 0.40, 1.80, 0.005, 1e-4, 3e-4, PLACE.gravity_m_s2)
    read = readings(LogReader(log), vehicle, "imu_base", calibrated=True)
    found, _ = calibrate_bifilar(read, vehicle, "imu_base", hung, (), PLACE.sigma_m_s2 / PLACE.gravity_m_s2)
    true = np.asarray(truth["inertia_kg_m2"])
    errors, relative = [], []
    for one in found.found[:6]:
        i, j = ("XYZ".index(letter) for letter in one.name[2:4])
        errors.append((one.value - true[i, j]) / one.sigma)
        relative.append((one.value - true[i, j]) / (true[i, i] if i == j else 0.5 * np.trace(true)))
    return {"z": errors, "percent": (100.0 * np.array(relative)).tolist()}


def imu(seed: int, directory: Path) -> dict[str, Any]:
    """The payload's mass with the datasheet's part as it comes, and calibrated."""
    scenario = scenario_of("dymaflex", {"sensor": {"imu_base": DATASHEET, "imu_2": DATASHEET}})
    before, log = vehicle_with(*UNCALIBRATED), directory / "table.mcap"
    truth = record("imu", before, scenario, seed, "imu_base", {}, log)
    found, _ = calibrate_imu(readings(LogReader(log), before, "imu_base"), before, "imu_base", ImuOptions(PLACE))
    after = config.parse(vehicle_file.changed(before, found.changes), before.path)
    true = np.asarray(truth["imu_base"]["gyro_matrix"])
    part = next(change for change in found.changes if change.key == "gyro_matrix")
    return {
        "gyro_scale_percent_before": (100.0 * (np.diag(true) - 1.0)).tolist(),
        "gyro_scale_percent_after": (100.0 * (np.diag(np.array(part.value)) - np.diag(true))).tolist(),
        **{
            name: _mass(scenario, seed, one, directory / f"{name}.mcap")
            for name, one in (("before", before), ("after", after))
        },
    }


def _mass(scenario: Scenario, seed: int, vehicle: config.Vehicle, log: Path) -> dict[str, Any]:
    world, urls = open_in_process(scenario, seed)
    with world:
        flown = hil.fly_simulated(vehicle, world, urls, log)
    said, true = mission_table.last_answers(LogReader(log)).get("m_payload"), flown.truth["quantities"]["m_payload"]
    if said is None or not said["supported"]:
        return {"value": None}
    return said | {"truth": true, "inside": said["low"] <= true <= said["high"]}


def cells(seed: int, directory: Path) -> dict[str, Any]:
    """The load cell's gain and offset against their sigmas."""
    vehicle, log = vehicle_with(), directory / "cell.mcap"
    masses = (0.0, 0.5, 1.0, 2.0)
    settings = {"masses_kg": masses, "sigma_kg": 1e-4, "arm_m": None}
    truth = record("load-cell", vehicle, scenario_of("dymaflex"), seed, "load_cell", settings, log)
    read = readings(LogReader(log), vehicle, "load_cell")
    found = calibrate_load_cell(read, vehicle, "load_cell", Masses(masses, 1e-4, PLACE)).found
    gain, offset = found[0], found[1]
    return {"z_gain": (gain.value - truth["load_cell"]["gain"]) / gain.sigma, "offset_N": offset.value}


WHATS = {"bifilar": bifilar, "imu": imu, "cells": cells}


def flown(what: str, seeds: range) -> Iterator[dict[str, Any]]:
    """Each seed's result, printed as it comes."""
    for seed in seeds:
        with tempfile.TemporaryDirectory() as directory:
            result = {"seed": seed, **WHATS[what](seed, Path(directory))}
        print(json.dumps(result), flush=True)
        yield result


def main() -> int:
    """Run a campaign and print its summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=tuple(WHATS))
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=5)
    asked = parser.parse_args()
    results = list(flown(asked.what, range(asked.first, asked.first + asked.seeds)))
    if asked.what == "bifilar":
        z, percent = (np.array([one[key] for one in results]) for key in ("z", "percent"))
        moments = [0, 2, 5]
        print(
            f"{len(z)} bodies: worst moment {np.abs(percent[:, moments]).max():.3f} %, worst of all "
            f"{np.abs(percent).max():.3f} %; {np.mean(np.abs(z) < 1.96):.1%} inside 95 %, "
            f"rms z {np.sqrt(np.mean(z**2)):.2f}"
        )
    elif asked.what == "imu":
        for name in ("before", "after"):
            rows = [one[name] for one in results if one[name]["value"] is not None]
            if not rows:
                print(f"{name}: none of {len(results)} answered")
                continue
            error = np.array([row["value"] / row["truth"] - 1.0 for row in rows])
            wide = np.array([(row["high"] - row["low"]) / row["truth"] for row in rows])
            inside = sum(row["inside"] for row in rows)
            print(
                f"{name}: {len(rows)} of {len(results)} answered, mass rms {100 * np.sqrt(np.mean(error**2)):.2f} %, "
                f"worst {100 * np.abs(error).max():.2f} %, interval {100 * wide.mean():.2f} % wide, {inside} inside"
            )
    else:
        z = np.array([one["z_gain"] for one in results])
        print(f"{len(z)} cells: gain {np.mean(np.abs(z) < 1.96):.0%} inside 95 %, rms z {np.sqrt(np.mean(z**2)):.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
