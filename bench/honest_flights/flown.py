"""Flights of a seed for ``bench/plans/honesty.toml`` and ``scoreboard.toml``: simulated ones, and recorded runs.

A recorded run is a payload on an air-bearing table, with columns spoilt. It becomes a log and is identified as ``heft
identify`` does; MuJoCo's numbers are the truth.
"""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.honest_flights.classes import of_class
from bench.honest_flights.drawn import MISSIONS, Drawn, draw
from bench.identification import free_flyer as bench_flyer
from bench.identification import planar
from bench.true_flights import free_flyer, planar_bed
from bench.true_flights.free_flyer import COUNTS_PER_TURN, Body, JointMotion
from bench.true_flights.free_flyer_sensors import SampledSignals, sample
from drivers.records import IMU, SCALAR, Rows
from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import open_in_process
from onboard import config
from onboard.dynamics.model.inertia import elements
from onboard.flight import hil
from onboard.ground.campaign import instants
from onboard.ground.campaign.results import FlightResult, of_log, of_mission
from onboard.ground.identify.identify import identify
from onboard.ground.identify.mission import mission_table
from onboard.identification.quantities import BODY
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter

Floats = NDArray[np.float64]
TABLE_S = 14.0
BOX = Body.box(5.0, (0.20, 0.16, 0.14), (0.03, -0.02, 0.08))


def flight(seed: int, settings: dict[str, Any]) -> FlightResult:
    """What came of a seed's flight.

    ``settings``: ``class``, else ``vehicle`` (drawn otherwise) and ``healthy``; ``identify``: what the command says of
    the log counts, and not what was said on board.
    """
    without = ""
    if "class" in settings:
        drawn, without = of_class(settings["class"], seed)
    else:
        drawn = draw(seed, settings.get("vehicle"), settings.get("healthy", False))
    found = run(drawn) if drawn.vehicle == "planar" else _simulated(drawn, without, settings)
    return found._replace(faults=drawn.texts, unseen=drawn.invisible, what=drawn.vehicle)


def _simulated(drawn: Drawn, without: str, settings: dict[str, Any]) -> FlightResult:
    """Through drivers, clocks and estimator, in virtual time."""
    scenario = scenario_of(drawn.vehicle, {**MISSIONS[drawn.vehicle], "fault": drawn.faults, **drawn.overrides})
    vehicle = _without(config.load(config.packaged(drawn.vehicle)), without)
    with tempfile.TemporaryDirectory() as directory:
        world, urls = open_in_process(scenario, drawn.seed)
        with world:
            flown = hil.fly_simulated(vehicle, world, urls, Path(directory) / "flight.mcap")
        log = LogReader(flown.log, kept=True)
        found = of_mission(mission_table.result(flown, log=log))
        if settings.get("identify"):
            truth = {one.quantity: one.truth for one in found.answers}
            return of_log(identify(vehicle, [flown.log]).logs[0], {"quantities": truth})
        return found.with_instants(instants.of_flight(log, vehicle, flown.truth))


def _without(vehicle: config.Vehicle, device: str) -> config.Vehicle:
    """The vehicle as its file would be without a device."""
    if not device:
        return vehicle
    devices = {name: table for name, table in vehicle.tree["device"].items() if name != device}
    return config.parse_tree(vehicle.tree | {"device": devices}, vehicle.path, config.Origin(f"without {device}"))


class Spoilt:
    """Channels of a recording, spoilt as drawn.

    Args:
        time_s: of all samples, (n,).
        drawn: the faults.
    """

    def __init__(self, time_s: Floats, drawn: Drawn) -> None:
        self._time_s = time_s
        self._faults = drawn.faults

    def spoilt(self, name: str, values: Floats) -> Floats:
        """A channel's values (n, ...) as recorded; NaN where there is no sample."""
        out = np.array(values, np.float64)
        for fault in self._faults:
            if fault["device"] != name:
                continue
            during = (self._time_s >= fault["start_s"]) & (self._time_s < fault.get("end_s", np.inf))
            if not during.any():
                continue
            match fault["kind"]:
                case "silent":
                    out[during] = np.nan
                case "stuck":
                    out[during] = out[max(int(np.argmax(during)) - 1, 0)]
                case "wrong":
                    out[during] *= 1.0 + fault["value"]
                case "delayed":
                    late = round(fault["value"] / float(self._time_s[1] - self._time_s[0]))
                    out[during] = np.roll(out, late, axis=0)[during]
        return out


def run(drawn: Drawn) -> FlightResult:
    """The answer of one recorded run."""
    rng = np.random.default_rng([drawn.seed, 0x13])
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "run.mcap"
        truth = _table(path, drawn, rng)
        log = identify(config.load(config.packaged("dymaflex_air_bearing")), [path]).logs[0]
    found = of_log(log, {"quantities": truth})
    return found._replace(answers=tuple(one for one in found.answers if one.quantity in truth))


def _table(path: Path, drawn: Drawn, rng: np.random.Generator) -> dict[str, float]:
    over = drawn.overrides
    base = bench_flyer.as_built(free_flyer.BASE, bench_flyer.BASE_SIGMA, rng)
    link = (over.get("link", bench_flyer.LINK_SIGMA[0]), *bench_flyer.LINK_SIGMA[1:])
    arm = tuple(bench_flyer.as_built(one, link, rng) for one in free_flyer.ARM)
    motion = JointMotion.draw(rng)
    start = np.array(planar.POSTURE_rad) + rng.uniform(-0.2, 0.2, 5)
    motion = replace(motion, start_rad=start, amplitude_rad=motion.amplitude_rad * np.array(planar.SWING)[:, None])
    drags = [
        planar_bed.Drag(rng.uniform(0.0, planar.GOOD_N_s_m), rng.uniform(0.0, planar.GOOD_N))
        for _ in planar_bed.PUCKS_m
    ]
    drags[int(rng.integers(3))] = planar_bed.Drag(rng.uniform(*planar.VISCOUS_N_s_m), rng.uniform(*planar.COULOMB_N))
    velocity = rng.standard_normal(3) * [planar.VELOCITY_m_s, planar.VELOCITY_m_s, planar.RATE_rad_s]
    world = planar_bed.world(BOX, base, arm, planar.TILT_m_s2 * rng.standard_normal(2))
    read = sample(planar_bed.fly(world, motion, velocity, drags, TABLE_S), bench_flyer.ERRORS, rng)
    _write(path, _of_table(read, Spoilt(read.time_s, drawn), over.get("zero_rad", 1e-3) * rng.standard_normal(5)))
    return _truth(BOX, "payload", ("m", "c_x", "c_y", "I_zz"))


def _of_table(read: SampledSignals, columns: Spoilt, zeros: Floats) -> dict[str, Rows]:
    both = columns.spoilt("imu_base", np.hstack([read.rate_rad_s, read.specific_force_m_s2]))
    there = np.flatnonzero(np.isfinite(both).all(axis=1))
    imu = np.zeros(len(there), IMU)
    imu["sequence"], imu["host_ns"] = there, np.rint(1e9 * (10.0 + read.time_s[there]))
    imu["gyro_scale_rad_s"], imu["accel_scale_m_s2"] = 1e-4, 1e-3
    imu["gyro_raw"], imu["accel_raw"] = np.rint(both[there, :3] / 1e-4), np.rint(both[there, 3:] / 1e-3)
    channels = {"imu_base": imu}
    for k in range(5):
        angle = columns.spoilt(f"joint_{k + 1}", read.angle_rad[:, k] + zeros[k])
        channels[f"joint_{k + 1}"] = _scalars(read.time_s, angle, 2.0 * np.pi / COUNTS_PER_TURN, b"rad")
    return channels


def _scalars(time_s: Floats, values: Floats, scale: float, unit: bytes) -> Rows:
    there = np.flatnonzero(np.isfinite(values))
    made = np.zeros(len(there), SCALAR)
    made["sequence"], made["host_ns"] = there, np.rint(1e9 * (10.0 + time_s[there]))
    made["value_raw"], made["scale"], made["unit"] = np.rint(values[there] / scale), scale, unit
    return made


def _write(path: Path, channels: dict[str, Rows]) -> None:
    with LogWriter.create(path, durable=False, overwrite=True) as writer:
        for name, rows in channels.items():
            writer.register(name, rows.dtype)
            writer.write(name, rows)


def _truth(body: Body, link: str, names: tuple[str, ...]) -> dict[str, Any]:
    values = [body.mass_kg, *body.centre_of_mass_m, *elements(body.inertia_kg_m2)]
    return {f"{name}_{link}": value for name, value in zip(BODY, values, strict=True) if name in names}
