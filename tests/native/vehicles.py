"""Random vehicles, their motion, and errors of everything, for the compiled core and its oracle."""

from typing import NamedTuple

import numpy as np

from onboard import config
from onboard.dynamics.air_bearing import PlanarDrag, PlanarRun
from onboard.dynamics.free_flight import Push
from onboard.dynamics.joint_errors import EncoderReadings, JointErrors
from onboard.dynamics.kinematics import chain_motion
from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.dynamics.ticks import FlightSignals
from onboard.flight.estimate.problem.model import build_model
from onboard.flight.estimate.problem.priors import free_flyer_prior, geometry_prior
from onboard.identification.evidence.bank import Suspect
from onboard.identification.free_flyer.prediction.further import (
    CellPrior,
    DisturbancePrior,
    Friction,
    FurtherCell,
    FurtherImu,
    Thruster,
)
from onboard.identification.free_flyer.prediction.imu_errors import SIZE, ImuReading
from onboard.identification.free_flyer.prediction.imu_prediction import ImuPredictor
from onboard.identification.free_flyer.prediction.parameters import EXACT_GEOMETRY
from tests.dynamics.mujoco_twin import random_vehicle, to_urdf

PERIOD_s = 0.01


class Case(NamedTuple):
    """A vehicle, and a few ticks of its flight."""

    vehicle: VehicleModel
    readings: EncoderReadings
    errors: JointErrors
    of_joints: np.ndarray  # (joints, 6)
    multiples: np.ndarray  # (k,) of the first functions
    free: tuple[int, ...]
    bases: list[np.ndarray]
    push: Push
    rate: np.ndarray

    @property
    def corrected(self):
        return self.readings.corrected(self.of_joints, self.multiples, self.errors.of_cyclic)

    @property
    def chain(self):
        return chain_motion(self.vehicle, *self.corrected[:3], self.of_joints[:, :3])


def random_case(seed: int) -> Case:
    """Trees of one to seven bodies, revolute, prismatic and fixed joints, four to sixteen ticks, any links unknown."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 8))
    kinds = ["revolute", *rng.choice(["revolute", "prismatic", "fixed"], count - 1).tolist()]
    parents = [int(rng.integers(0, k + 1)) for k in range(count)]
    vehicle = VehicleModel(to_urdf(random_vehicle(rng, kinds, parents)), VehicleSpec(BaseKind.FREE, "base"))
    n, joints, links = int(rng.integers(4, 17)), len(vehicle.joints), len(vehicle.links)
    m, k = int(rng.integers(0, 5)), int(rng.integers(0, 4))
    motion = rng.normal(size=(3, 1, joints)) + 0.1 * rng.normal(size=(3, n, joints))
    readings = EncoderReadings(*motion, PERIOD_s, rng.normal(size=(n, 3, m)))
    errors = JointErrors(vehicle, rng.integers(0, joints, m).tolist())
    of_joints = 1e-2 * rng.normal(size=(joints, 6))
    free = tuple(rng.permutation(links)[: rng.integers(0, links + 1)].tolist())
    bases = [np.eye(10) if rng.random() < 0.3 else rng.normal(size=(10, 10)) for _ in free]
    push = Push(rng.normal(size=(n, 6, k)), rng.normal(size=k) if rng.random() < 0.7 else np.zeros(k))
    multiples = 1e-3 * rng.normal(size=int(rng.integers(0, m + 1)))
    return Case(vehicle, readings, errors, of_joints, multiples, free, bases, push, 0.1 * rng.normal(size=3))


class OnTable(NamedTuple):
    """What :func:`onboard.dynamics.air_bearing.predict_run` takes."""

    run: PlanarRun
    start: np.ndarray
    chi: np.ndarray
    drag: PlanarDrag
    tilt: np.ndarray
    free: tuple[int, ...]


def on_table(case: Case, seed: int) -> OnTable:
    """The vehicle on none to four pucks."""
    rng, n = np.random.default_rng(seed), len(case.rate)
    k, motion = seed % 5, case.corrected[:3]
    run = PlanarRun(case.vehicle, FlightSignals(PERIOD_s, *motion, *np.ones((2, n, 3)), *np.ones((2, 3)), 1))
    drag = PlanarDrag(rng.normal(size=(k, 2)), *rng.uniform(0.0, 1.0, (2, k)), tuple(rng.normal(size=3).tolist()))
    return OnTable(run, 0.3 * rng.normal(size=3), case.vehicle.chi, drag, 0.1 * rng.normal(size=2), case.free)


def random_predictor(seed: int) -> ImuPredictor:
    """A packaged free-flyer with and without errors of joints, load cells, torques, IMUs, thrusters, disturbances."""
    rng, vehicle = np.random.default_rng(seed), config.load(config.packaged("dymaflex"))
    model = build_model(vehicle)
    covariance, prior, _ = free_flyer_prior(vehicle, model)
    some = {name: covariance[name] for name in list(covariance)[: seed % 3 * 2]}
    cell = FurtherCell("cell", "link_5", (0.6, 0.5, 0.2, 0.3, -0.7, 0.9), 5, CellPrior(0.03, 1e-4, 0.0025, 2e-4))
    rubs = Friction(1, 0.3, 0.2, 0.1)
    torque = FurtherCell("torque", "joint_2", (0, 0, 0, 0, 1, 0), 5, CellPrior(0.1, 0.0, 0.01, 2e-4), rubs)
    further = [cell, torque, FurtherImu("imu_2", "imu_2", 10, prior, 0.003, 1.0)][: seed % 4]
    thrusters = [Thruster(f"thruster_{k}", rng.normal(size=6), 0.05 * k) for k in range(seed % 3)]
    geometry = geometry_prior(vehicle, model) if seed % 2 else EXACT_GEOMETRY
    pushed = DisturbancePrior(0.01, 0.002, 60.0) if seed % 5 else DisturbancePrior()
    given = "imu_base", PERIOD_s, 10, some, prior, geometry, further, "imu", thrusters, pushed
    return ImuPredictor(model, *given)


def predicted_from(predictor: ImuPredictor, seed: int) -> tuple[np.ndarray, ...]:
    """Arguments of its prediction: joints, state, cyclic errors' functions, forces of thrusters; None for some."""
    rng, n, joints = np.random.default_rng(seed), 4 + seed % 9, len(predictor.vehicle.joints)
    motion = rng.normal(size=(3, 1, joints)) + 0.1 * rng.normal(size=(3, n, joints))
    sigma = np.where(np.isnan(predictor.sigma), 0.1, predictor.sigma)
    state = sigma * rng.normal(size=len(sigma))
    state[3:13] = [5.0, 0.15, -0.1, 0.4, 0.1, 0.001, 0.1, 0.01, 0.02, 0.1]
    cyclic = rng.normal(size=(n, 3, predictor.cyclic_slopes.shape[-1]))
    thrust = rng.normal(size=(n, len(predictor.thrusters)))
    return *motion, state, cyclic if seed % 3 else None, thrust if seed % 4 else None


def random_suspects(seed: int) -> tuple[list[Suspect], np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Suspects of one to twelve constants, the stated sigmas of these, and what some readings tell of them."""
    rng, size = np.random.default_rng(seed), 14
    sigma, suspects = rng.uniform(0.1, 2.0, size), list[Suspect]()
    for k in range(6):
        at = np.sort(rng.permutation(size)[: rng.integers(1, 13)])
        along = rng.normal(size=(len(at), 1 if k < 3 else int(rng.integers(1, len(at) + 1))))
        suspects.append(Suspect(f"suspect {k}", at, along, float(rng.uniform(1e-3, 0.1))))
    H = rng.normal(size=(10, size))
    covariance = np.linalg.inv(np.diag(sigma**-2) + H.T @ H)
    return suspects, sigma, (covariance @ (H.T @ rng.normal(size=10)), covariance)


def lines_of_imu(seed, use=slice(None)):
    """What an IMU shows at the middles of some ticks, and what it has measured in some of them."""
    rng = np.random.default_rng(seed)
    n, total = int(rng.integers(5, 40)), int(rng.integers(4, 30))
    gain, ticks = rng.normal(size=(n, 6, 9)), np.zeros(n, np.bool_)
    gain[:, :3, 3:], ticks[use] = 0.0, True  # a rate depends on the base's rate alone
    shown = ImuReading(rng.normal(size=(n, 6)), rng.normal(size=(n, 6, SIZE)))
    places = np.sort(rng.permutation(total + SIZE)[: int(rng.integers(1, total + SIZE))])
    told = rng.normal(size=(n, 6)), rng.uniform(0.5, 2.0, (n, 6))
    return shown, 0.2 * rng.normal(size=SIZE), (gain, rng.normal(size=(n, 9, total))), 7, told, (places, ticks)
