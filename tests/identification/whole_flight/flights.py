"""A flight of the twin that begins with nothing held, and its whole fit."""

import numpy as np

from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.payload import standard_covariance
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.identification.free_flyer.prediction.imu_errors import ImuPrior
from onboard.identification.free_flyer.prediction.imu_prediction import PAYLOAD, ImuPredictor
from onboard.identification.free_flyer.prediction.parameters import GeometryPrior, JointPrior
from onboard.identification.whole_flight import witnesses
from onboard.identification.whole_flight.segments import Segment
from tests.dynamics.free_flyer_twin import URDF

PRIOR = ImuPrior(0.01, 1e-4, 0.003, 0.0035, 0.1, 1e-3, 0.003, 0.0035, 1e-4)
CAPTURE_s, END_s = 6.0, 14.0


def predictor_of(cyclic=()):
    """Of the twin; cyclic errors of each joint."""
    vehicle = VehicleModel(URDF.read_text(), VehicleSpec(BaseKind.FREE, "base", "payload"))
    chi = {name: vehicle.chi[10 * k : 10 * k + 10] for k, name in enumerate(vehicle.links)}
    links = {name: standard_covariance(chi[name], 0.03, 2e-3, 0.01) for name in ("base", "link_2")}
    geometry = GeometryPrior(
        0.003, {joint.name: JointPrior(5e-4, 1e-3, 2e-4, 2e-4, cyclic) for joint in vehicle.joints}
    )
    return ImuPredictor(
        vehicle, "imu_base", 0.01, 5, links, PRIOR, geometry, key_of=lambda name: name.partition("_inertial_")[0]
    )


def segments(ticks):
    free, held = ticks.time_s < CAPTURE_s - 0.1, ticks.time_s > CAPTURE_s + 0.1
    return [Segment(ticks.part(slice(*np.flatnonzero(which)[[0, -1]])), own) for which, own in ((free, 0), (held, 1))]


def started(flight, predictor, chi):
    return flight.start(np.concatenate([chi, np.zeros(len(predictor.names) - PAYLOAD.stop)]))


def scaled(ticks, columns, factor):
    """All that was flown, some readings of the IMU times a factor."""
    measured = ticks.measured.copy()
    measured[:, columns] *= factor
    return segments(ticks._replace(measured=measured))


def fitted_freely(flight, whole):
    """A fit in which what is likely wrong is free."""
    return witnesses.fitted(flight, whole.fit.x, (), lambda time_s: 0)


def spoilt_from(ticks, at_s, factor):
    """The ticks with all axes of the accelerometer times a factor from a time on."""
    measured = ticks.measured.copy()
    measured[np.searchsorted(ticks.time_s, at_s) :, 3:6] *= factor
    return ticks._replace(measured=measured)
