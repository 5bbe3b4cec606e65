"""An estimator that heft does not name runs over a flight's log by its entry in ``METHODS`` alone."""

from pathlib import Path

import numpy as np
import pytest

from onboard import config
from onboard.config.methods import METHODS, EstimationMethod
from onboard.dynamics.model.vehicle import VehicleModel
from onboard.estimation.arrays import BoolArray
from onboard.estimation.gates import ReasonArray
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.problem.model import build_model
from onboard.ground.identify.replay.feed import feed
from onboard.identification.quantities import Estimate, QuantityEstimate
from onboard.identification.table.run import TableRun
from onboard.regressor.signals import Signals
from tests.flight.missions import fly

STILL = [{"phase": 0, "action": "hold", "duration_s": 3.0}]


class MeanRate(TableRun):
    """The mean rate of the base about x, rad/s."""

    def __init__(self, payload: str) -> None:
        super().__init__(payload)
        self.quantity_names = ("mean_rate_x",)
        self.rates: list[float] = []

    def update(self, signals: Signals, attached: BoolArray, excluded: ReasonArray) -> ReasonArray:
        gates = super().update(signals, attached, excluded)
        self.rates += signals.measured[gates[:, 0] == 0, 0].tolist()
        self.rows_used = len(self.rates)
        return gates

    def estimate(self) -> Estimate:
        mean = float(np.mean(self.rates)) if self.rates else np.nan
        sigma = float(np.std(self.rates) / np.sqrt(len(self.rates))) if self.rates else np.nan
        half = 1.96 * sigma
        told = "mean_rate_x", "rad/s", mean, sigma, mean - half, mean + half, bool(self.rates)
        answer = QuantityEstimate(*told, shrinkage=1.0)
        return super().estimate()._replace(quantities=(answer,))


def build(vehicle: config.Vehicle) -> tuple[MeanRate, VehicleModel]:
    model = build_model(vehicle)
    return MeanRate(str(model.spec.payload_link)), model


def test_it_answers_from_the_flights_ticks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flown = fly(
        tmp_path / "flight.mcap", 3, vehicle="dymaflex", sequence=STILL, capture={"earliest_s": 1.5, "latest_s": 2.0}
    )
    mean_rate = EstimationMethod("mean_rate", tick_means=True, builder=f"{__name__}:build")
    monkeypatch.setitem(METHODS, "mean_rate", mean_rate)
    vehicle = config.load(config.packaged("dymaflex"))
    settings = vehicle.file.estimation.model_copy(update={"method": "mean_rate"})
    outside = vehicle.model_copy(update={"file": vehicle.file.model_copy(update={"estimation": settings})})
    estimator = Estimator(outside, at_the_end=True)
    for _ in feed(estimator, flown.log):
        pass
    (answer,) = estimator.online.estimate().quantities
    imu = flown.log.read("imu_base")
    shown = float(np.mean(imu["gyro_raw"][:, 0] * imu["gyro_scale_rad_s"]))
    assert estimator.online.rows_used > 100
    assert answer.value == pytest.approx(shown, abs=5.0 * answer.sigma)
