"""A mapping with a mistake: it is named, before anything is fitted; a recording as stated is said nothing of."""

import json
import time

import numpy as np
import pytest

from onboard.cli import OK, main
from onboard.dynamics.model.bases import BASES
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec
from onboard.dynamics.ticks import tick_signals
from onboard.identification.free_flyer.misread import misread
from onboard.identification.free_flyer.prediction.ticks import Ticks
from tests.ground.identify.kinds.free_arm import JOINTS, flown

_WIDTH_s = 0.8
_FORCE_NOISE_m_s2, _RATE_NOISE_rad_s = 0.02, 1e-3  # of a sample, 2 ms
_FLIPPED_x, _TURNED = np.diag([-1.0, 1.0, 1.0]), np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def urdf(tmp_path_factory):
    """Of the vehicle that heft init writes."""
    lab = tmp_path_factory.mktemp("free") / "lab"
    asked = ["--base", "free", "--joints", ",".join(JOINTS), "--imu", "recorded", "--encoder", "recorded"]
    assert main(["init", str(lab), *asked]) == OK
    return (lab / "vehicle.urdf").read_text()


@pytest.fixture(scope="module")
def flight(urdf):
    """Time (n,), angles (n, 3), rate and specific force (n, 3), read with noise."""
    t, angles, rate, force = flown(urdf, 50.0)
    rng = np.random.default_rng(7)
    noise = rng.normal(0.0, _RATE_NOISE_rad_s, rate.shape), rng.normal(0.0, _FORCE_NOISE_m_s2, force.shape)
    return t, angles, rate + noise[0], force + noise[1]


def _misread(urdf, t, angles, rate, force):
    model = VehicleModel(urdf, VehicleSpec(BASES["free"], "base", "payload"))
    signals = tick_signals(t, angles, rate, force, (1e-3, 0.02), 9, _WIDTH_s)
    n, still = len(signals.q), np.zeros((len(signals.q), 2, 3))
    measured = np.hstack([signals.rate, signals.specific_force])
    grid = signals.period_s * np.arange(n), signals.q, signals.dq, signals.ddq, measured, np.ones((n, 6))
    ticks = Ticks(*grid, still, still, np.zeros((n, 3, 0)), np.zeros((n, 0)), np.ones(n))
    return misread(model, "imu_base", ticks, signals.period_s, _WIDTH_s)


_MISTAKES = {
    "the gyro's x and y are exchanged": lambda q, w, f: (q, w[:, [1, 0, 2]], f),
    "the accelerometer is in g": lambda q, w, f: (q, w, f / 9.80665),
    'the IMU\'s x, y, z are what is read as "+y", "-x", "+z"': lambda q, w, f: (q, w @ _TURNED, f @ _TURNED),
    "joint_2 counts the other way": lambda q, w, f: (q * [1.0, -1.0, 1.0], w, f),
    "joint_1 and joint_2 are exchanged": lambda q, w, f: (q[:, [1, 0, 2]], w, f),
    "joint_2 is about -60 deg from what is read": lambda q, w, f: (q + np.radians([0.0, 57.0, 0.0]), w, f),
}


_MORE = {  # a unit, axes and signs by themselves: above; an axis of the gyro: a command below finds it
    "the gyro is in deg/s": lambda q, w, f: (q, np.degrees(w), f),
    "the accelerometer's x and y and z count the other way": lambda q, w, f: (q, w, -f),
    "joint_2 counts the other way and the accelerometer is in g": lambda q, w, f: (
        q * [1.0, -1.0, 1.0],
        w,
        f / 9.80665,
    ),
    "the gyro's x counts the other way": lambda q, w, f: (q, w @ _FLIPPED_x, f),
    "the gyro is in deg/s and the accelerometer is in g": lambda q, w, f: (q, np.degrees(w), f / 9.80665),
}


@pytest.mark.parametrize("said", [*_MISTAKES, *(pytest.param(one, marks=pytest.mark.campaign) for one in _MORE)])
def test_a_mistake_is_named(urdf, flight, said):
    """Axes, units, signs, places; two at once, of joints and IMU."""
    t, angles, rate, force = flight
    found = _misread(urdf, t, *(_MISTAKES | _MORE)[said](angles, rate, force))
    assert found is not None
    assert f" if {said}" in found.text, found.text


def test_as_stated_nothing_is_said(urdf, flight):
    """With the noise and zeros of a cheap IMU and angles of 14 bits, too; nor where nothing moves."""
    t, angles, rate, force = flight
    rng = np.random.default_rng(8)
    coarse = np.rint(angles / (2.0 * np.pi) * 2**14) * 2.0 * np.pi / 2**14
    cheap = rate + rng.normal(0.0, 5e-3, rate.shape) + 0.02, force + rng.normal(0.0, 0.1, force.shape) + 0.1
    assert _misread(urdf, t, angles, rate, force) is None
    assert _misread(urdf, t, coarse, *cheap) is None
    assert _misread(urdf, t, np.zeros_like(angles), 0.0 * rate, 0.0 * force) is None


@pytest.mark.parametrize(("long_s", "named"), [(4.5, False), (5.0, True)])
def test_a_recording_that_determines_too_little_is_said_nothing_of(urdf, flight, long_s, named):
    """Payload and zero are 13 unknowns: three widths of the kernel, six lines each, besides the two at the ends."""
    t, angles, rate, force = (one[: round(long_s / 2e-3)] for one in flight)
    assert (_misread(urdf, t, angles, np.degrees(rate), force) is not None) == named


def verdict_of(tmp_path, t, force, rate, angles, stated=""):
    """What heft identify says, by the commands of the page, of columns that are called as if they were right."""
    lab, table = tmp_path / "lab", tmp_path / "flight.csv"
    asked = ["--base", "free", "--joints", ",".join(JOINTS), "--imu", "recorded", "--encoder", "recorded"]
    assert main(["init", str(lab), *asked]) == OK
    if stated:
        text = (lab / "vehicle.toml").read_text()
        assert text.count(f"# {stated}") == 1
        (lab / "vehicle.toml").write_text(text.replace(f"# {stated}", stated))
    names = ["t", *(f"acc_{axis}_m_s2" for axis in "xyz"), *(f"gyro_{axis}_rad_s" for axis in "xyz"), *JOINTS]
    np.savetxt(table, np.column_stack([t, force, rate, angles]), "%.6f", ",", header=",".join(names), comments="")
    mapping, answer, vehicle = str(tmp_path / "m.toml"), tmp_path / "answer.json", str(lab / "vehicle.toml")
    assert main(["import", "--guess", str(table), "--vehicle", vehicle, "-o", mapping]) == OK
    assert main(["import", mapping, str(table), "-o", str(tmp_path)]) == OK
    begun_s = time.process_time()
    assert main(["identify", "--vehicle", vehicle, str(tmp_path / "flight.mcap"), "--json", str(answer)]) == 1
    assert time.process_time() - begun_s < 30.0
    (log,) = json.loads(answer.read_text())["logs"]
    return log["verdict"]


def test_heft_identify_says_it_and_fits_nothing(tmp_path, flight):
    t, angles, rate, force = (one[::5] for one in flight)
    verdict = verdict_of(tmp_path, t, force, rate @ _FLIPPED_x, angles)
    assert verdict["level"] == "do not use"
    assert "if the gyro's x counts the other way: correct the mapping" in verdict["text"]


def test_what_no_mistake_explains_is_refused_with_what_to_check(tmp_path, flight):
    """A gyro that reads ten times as much, which no unit makes: the fit fails, and no reason is claimed."""
    t, angles, rate, force = (one[:1500:10] for one in flight)
    verdict = verdict_of(tmp_path, t, force, 10.0 * rate, angles, "smoothing_ms = 100")  # else three widths are tried
    assert "the fit failed" in verdict["text"]
    assert "check axes and units of the IMU, signs, units, order and zeros of the joints" in verdict["text"]
