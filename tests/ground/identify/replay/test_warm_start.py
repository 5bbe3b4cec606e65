"""A flight goes on from the log of the one before: what it knew stays known, and no surer than it was."""

from pathlib import Path

import numpy as np
import pytest

from bench.true_flights import free_flyer
from onboard import cli, config
from onboard.estimation.recursive.rls import SquareRootRls
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.store.flight_log import preamble
from onboard.ground.identify.identify import identify
from onboard.ground.identify.replay.feed import feed
from onboard.ground.identify.replay.warm_start import go_on
from onboard.ground.log.tables.vehicle_file import vehicle_of
from onboard.identification.free_flyer.online import MotionIdentifier
from onboard.identification.standing import Level
from onboard.recording.format.errors import ChannelError
from onboard.recording.reader import LogReader
from onboard.recording.writer import LogWriter
from tests.dynamics.free_flyer_twin import PAYLOAD, twin
from tests.ground.identify import throws
from tests.ground.identify.test_identify import LOAD, TUDELFT, TUMBLES, with_carrier
from tests.ground.identify.test_identify_free_flyer import write as free_flight

WHOLE = with_carrier(LOAD)


def throw(path: Path, w0: list[float], rng: np.random.Generator) -> Path:
    return throws.write(path, WHOLE.inertia_kg_m2, WHOLE.centre_of_mass_m, w0, rng)


def flown(path: Path, w0: list[float], rng: np.random.Generator) -> LogReader:
    """What the estimator said on a throw, as a flight's log has it."""
    estimator, source = Estimator(TUDELFT), LogReader(throw(path.with_name("config_a_source.mcap"), w0, rng))
    with LogWriter.create(path, durable=False) as writer:
        for name, dtype in estimator.outputs.items():
            writer.register(name, dtype)
        for channel, rows in feed(estimator, source):
            if channel in estimator.outputs:
                writer.write(channel, rows)
    return LogReader(path)


def test_a_prior_with_a_common_cause_is_the_rows_it_stands_for(rng: np.random.Generator) -> None:
    """Rows, then the rest of the rows on what they gave: the same as all rows at once, sensitivity included."""
    p, n = 4, 50
    Y, C, y = rng.normal(size=(2 * n, p)), rng.normal(size=(2 * n, 2)), rng.normal(size=2 * n)
    sigma = np.full(2 * n, 0.3)
    whole, first, second = (SquareRootRls(p, 2) for _ in range(3))
    whole.update(Y, y, sigma, C)
    first.update(Y[:n], y[:n], sigma[:n], C[:n])
    told = first.solve()
    second.prior(told.mean, told.covariance, told.sensitivity)
    second.update(Y[n:], y[n:], sigma[n:], C[n:])
    for one, other in zip(second.solve()[:3], whole.solve()[:3], strict=True):
        np.testing.assert_allclose(one, other, atol=1e-10)


def test_the_second_flight_knows_more_and_claims_no_less_than_both(tmp_path: Path, rng: np.random.Generator) -> None:
    earlier = flown(tmp_path / "earlier.mcap", TUMBLES[0], rng)
    log = throw(tmp_path / "config_a.mcap", TUMBLES[1], rng)
    went_on = go_on(TUDELFT, earlier)
    (alone,), (both,) = (identify(vehicle, [log]).logs for vehicle in (TUDELFT, went_on))
    assert both.verdict.level is Level.GOOD
    last = earlier.read("quantity")
    said = {row["name"].decode(): row for row in last[-len(both.answers) :]}
    for one, two in zip(alone.answers, both.answers, strict=True):
        if not one.supported:
            continue
        assert two.bound <= 1.001 * one.bound
        mine, before = 1.0 / two.sigma**2, 1.0 / one.sigma**2 + 1.0 / said[one.name]["sigma"] ** 2
        assert mine < 1.5 * before  # never surer than the two together
        assert abs(two.value - one.value) < 3.0 * np.hypot(one.sigma, two.sigma)
    assert sum(two.sigma < one.sigma for one, two in zip(alone.answers, both.answers, strict=True)) > 8


def test_a_flight_that_shows_nothing_keeps_what_was_known(tmp_path: Path, rng: np.random.Generator) -> None:
    """Between the estimate carried and its interval, whatever few rows come after the restart."""
    earlier = flown(tmp_path / "earlier.mcap", TUMBLES[0], rng)
    start = Estimator(go_on(TUDELFT, earlier)).identifier
    last = earlier.read("estimate")[-1]
    told = start.rls.solve()
    said = earlier.read("quantity")[-len(last["mean"]) - len(start.quantities) :][: len(last["mean"])]
    fine = said["supported"] != 0
    assert fine.sum() > 8
    half = 0.5 * (said["high"] - said["low"])
    np.testing.assert_array_less(np.abs(told.mean - last["mean"])[fine], 0.2 * half[fine])
    considered = told.sensitivity * np.array([cause.sigma for cause in start.considered])
    sigma = np.sqrt(np.diag(told.covariance) + (considered**2).sum(axis=1))
    assert (1.96 * sigma[fine] > 0.99 * half[fine]).all()


def test_the_log_of_such_a_flight_replays_by_itself(tmp_path: Path, rng: np.random.Generator) -> None:
    vehicle = go_on(TUDELFT, flown(tmp_path / "earlier.mcap", TUMBLES[0], rng))
    with LogWriter.create(tmp_path / "log.mcap", durable=False) as writer:
        for attachment in preamble(vehicle, "").attachments:
            writer.attach(attachment.name, attachment.media_type, attachment.data)
    again = vehicle_of(LogReader(tmp_path / "log.mcap"), tmp_path)
    assert again.file == vehicle.file
    assert again.file.estimation.carried is not None
    one, two = (Estimator(v).identifier.rls.state().triangle for v in (vehicle, again))
    np.testing.assert_array_equal(one, two)


def test_what_there_is_nothing_to_go_on_from(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = throw(tmp_path / "config_a.mcap", TUMBLES[0], rng)
    arguments = ["identify", "--vehicle", "tudelft", "--from", str(bare), str(bare)]
    assert cli.main(arguments) == cli.BAD_INPUT
    assert "there is nothing to go on from" in capsys.readouterr().err
    vehicle = str(config.packaged("tudelft"))
    assert cli.main(["fly", vehicle, "--continue", str(bare)]) == cli.BAD_INPUT
    assert "there is nothing to go on from" in capsys.readouterr().err
    earlier = flown(tmp_path / "earlier.mcap", TUMBLES[0], rng)
    with pytest.raises(ChannelError):
        go_on(config.load(config.packaged("rocksat")), earlier)
    with pytest.raises(config.ConfigError, match=r"goes on from earlier\.mcap already"):
        go_on(go_on(TUDELFT, earlier), earlier)
    with pytest.raises(ChannelError):
        go_on(dymaflex(), earlier)
    text = go_on(TUDELFT, earlier).text.replace('"MX_body"', '"MX_box"')
    with pytest.raises(config.ConfigError, match="Go on with the vehicle that flew then"):
        Estimator(config.parse(text, TUDELFT.path))


def test_identify_goes_on_by_command(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    earlier = flown(tmp_path / "earlier.mcap", TUMBLES[0], rng)
    log = throw(tmp_path / "config_a.mcap", TUMBLES[1], rng)
    assert cli.main(["identify", "--vehicle", "tudelft", "--from", str(earlier.path), str(log)]) == cli.OK
    assert "config_a" in capsys.readouterr().out


# --- a free-flyer ---------------------------------------------------------------------------------------------------


def dymaflex(held_at_start: bool = True) -> config.Vehicle:
    packaged = config.load(config.packaged("dymaflex_parabolic"))
    text = f"{packaged.text}\n[estimation.exiddm]\nheld_at_start = {str(held_at_start).lower()}\n"
    return config.parse(text, packaged.path)


def said_of(vehicle: config.Vehicle, log: Path, out: Path) -> tuple[Estimator, LogReader]:
    """The recursive estimator on a log, and what it said as a flight's log has it."""
    estimator = Estimator(vehicle)
    with LogWriter.create(out, durable=False) as writer:
        for name, dtype in estimator.outputs.items():
            writer.register(name, dtype)
        for channel, rows in feed(estimator, LogReader(log)):
            if channel in estimator.outputs:
                writer.write(channel, rows)
    return estimator, LogReader(out)


def test_a_free_flyer_knows_its_payload_again(tmp_path: Path, rng: np.random.Generator) -> None:
    """After a restart with the payload in its grip, where the file says that a flight begins with nothing held.

    If it is another one after all, nobody says that it is the same.
    """
    _, earlier = said_of(dymaflex(), free_flight(tmp_path / "one.mcap", twin(6.0), rng), tmp_path / "said.mcap")
    went_on, flown_again = go_on(dymaflex(held_at_start=False), earlier), twin(3.0, seed=8)
    log = free_flight(tmp_path / "two.mcap", flown_again, rng)
    estimator, _ = said_of(went_on, log, tmp_path / "again.mcap")
    assert isinstance(estimator.online, MotionIdentifier)
    ekf = estimator.online.ekf
    assert ekf.held
    found = ekf.estimate()
    assert found is not None
    sigma = np.sqrt(found.covariance[0, 0])
    assert abs(found.body.mass_kg - PAYLOAD.mass_kg) < 4.0 * sigma
    alone, _ = said_of(dymaflex(), log, tmp_path / "alone.mcap")
    assert isinstance(alone.online, MotionIdentifier)
    anew = alone.online.ekf.estimate()
    assert anew is None or sigma < np.sqrt(anew.covariance[0, 0])
    other = free_flyer.Body.box(1.5, (0.1, 0.1, 0.2), (0.0, 0.02, 0.1))
    flight = free_flyer.fly(free_flyer.world(other), flown_again.motion, (0.03, -0.02, 0.04), 3.0)
    log = free_flight(tmp_path / "other.mcap", flown_again._replace(flight=flight), rng)
    estimator, _ = said_of(went_on, log, tmp_path / "said_other.mcap")
    assert isinstance(estimator.online, MotionIdentifier)
    found = estimator.online.ekf.estimate()  # it may take more than these seconds; the old answer it is never
    assert found is None or abs(found.body.mass_kg - 1.5) < 4.0 * np.sqrt(found.covariance[0, 0])
    with LogWriter.create(tmp_path / "empty.mcap", durable=False) as writer:
        for name in ("estimate", "quantity"):
            rows = earlier.read(name)[-len(estimator.online.estimate().quantities) - 10 :]
            if name == "estimate":
                rows["triangle"] = 0.0
            writer.register(name, rows.dtype)
            writer.write(name, rows)
    with pytest.raises(ChannelError, match="nothing was held at the end of that flight"):
        go_on(dymaflex(), LogReader(tmp_path / "empty.mcap"))
