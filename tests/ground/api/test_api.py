"""``import heft``: the same numbers as the log and its dump, in SI, in frames, on sample time."""

import numpy as np
import pandas as pd
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import heft
from drivers import records
from onboard.channels import QUANTITY, outer_ends
from onboard.cli import main
from onboard.ground.identify import identify
from onboard.ground.identify.replay import replay
from onboard.recording.format.errors import ChannelError
from onboard.recording.writer import LogWriter

WALL_NS = 1_795_190_705_000_000_000


def quantities():
    rows = np.zeros(3, QUANTITY)
    rows["host_ns"], rows["vehicle_ns"] = 5_000_000_000, [5_000_000_000, 6_000_000_000, 7_000_000_000]
    rows["name"], rows["unit"], rows["supported"] = b"mass", b"kg", [0, 1, 1]
    rows["value"] = [np.nan, 4.5, 5.0]
    rows["low"], rows["high"], rows["low_999"], rows["high_999"] = 4.0, 4.8, 3.0, 6.0
    return rows


def log_of(path, channels, **facts):
    with LogWriter.create(path) as writer:
        writer.add_metadata("flight", {name: str(value) for name, value in facts.items()})
        for name, rows in channels.items():
            writer.register(name, rows.dtype)
            writer.write(name, rows)
    return path


@pytest.fixture
def told(tmp_path):
    event = records.event(6_000_000_000, records.Severity.WARNING, "phase", "test", "=1+1").rows
    later = records.event(5_500_000_000, records.Severity.INFO, "begin", "other", "begun").rows
    gap = records.gap(6_500_000_000, "imu", 3, 5, 1000, "lost").rows
    channels = {"quantity": quantities(), "event": event, "event_estimation": later, "gap": gap}
    return heft.open(log_of(tmp_path / "a.mcap", channels, wall_clock_ns=WALL_NS, monotonic_ns=5_000_000_000))


def test_what_was_told_on_board_by_utc(told):
    estimates = told.estimates.to_pandas()
    assert estimates.index.tz is not None
    assert list(estimates.index) == [pd.Timestamp(WALL_NS + n * 10**9, tz="UTC") for n in (1, 2)]
    assert estimates["value"].tolist() == [4.5, 5.0]  # what the data did not support yet is no estimate
    assert estimates["unit"].tolist() == ["kg", "kg"]
    assert told.events.to_pandas()["code"].tolist() == ["begin", "phase"]  # of all workers, by time
    assert told.gaps.to_numpy()[["first_missing", "last_missing", "cause"]].tolist() == [(3, 5, "lost")]


def test_an_estimate_that_was_withdrawn_is_no_number(tmp_path):
    rows = np.concatenate([quantities(), quantities()[:1]])
    rows["value"][3], rows["vehicle_ns"][3] = 77.0, 8_000_000_000
    since = ("low_999", "high_999", "drawn", "level", "why")
    older = np.dtype([(name, QUANTITY[name]) for name in QUANTITY.names if name not in since])
    before = np.zeros(4, np.dtype(older.descr, align=True))
    for name in before.dtype.names:
        before[name] = rows[name]
    for number, made in enumerate((rows, before)):
        said = heft.open(log_of(tmp_path / f"{number}.mcap", {"quantity": made})).estimates.to_numpy()
        assert said["supported"].tolist() == [1, 1, 0]
        assert np.array_equal(said["value"], [4.5, 5.0, np.nan], equal_nan=True)
        low, high = outer_ends(said)
        if number:  # an older log: of a normal
            assert np.allclose([low[0], high[0]], 4.5 + np.array([-0.5, 0.3]) * 3.2905 / 1.96)
        else:
            assert (low[0], high[0]) == (3.0, 6.0)


def test_without_a_wall_clock_time_counts_from_the_first_record(tmp_path):
    log = heft.open(log_of(tmp_path / "a.mcap", {"quantity": quantities()}))
    assert list(log.estimates.to_pandas().index) == [pd.Timedelta(1, "s"), pd.Timedelta(2, "s")]
    assert log.estimates.utc is None
    assert log.estimates.to_xarray()["time"].values.tolist() == [10**9, 2 * 10**9]


def test_a_sample_of_no_known_clock_has_no_time(tmp_path):
    rows = np.zeros(2, records.SCALAR)
    rows["host_ns"], rows["unit"], rows["value_raw"], rows["scale"] = 5_000_000_000, b"N", [2, 3], 0.5
    log = heft.open(log_of(tmp_path / "a.mcap", {"cell": rows}))
    frame = log["cell"].to_pandas()
    assert frame.index.isna().all()
    assert frame["value"].tolist() == [1.0, 1.5]
    assert frame.attrs["units"] == {"value": "N"}
    assert log["cell"].to_pandas(raw=True)["value_raw"].tolist() == [2, 3]


def test_a_channel_that_is_not_there_names_those_that_are(told):
    assert "imu" not in told
    with pytest.raises(ChannelError, match="'imu'; it has quantity, event"):
        told["imu"]
    assert list(told.channels) == list(told) == ["quantity", "event", "event_estimation", "gap"]


def test_an_empty_table_is_a_table(told):
    empty = np.zeros(0, QUANTITY)
    log = heft.open(log_of(told.path.with_name("b.mcap"), {"quantity": empty}))
    assert len(log.estimates.to_pandas()) == len(log.gaps.to_pandas()) == 0
    assert log.estimates.to_xarray().sizes == {"time": 0}


def test_identify_asks_for_a_vehicle_where_the_log_has_none(told):
    with pytest.raises(ValueError, match="carries no vehicle file; give the vehicle"):
        heft.identify(told)


def _blas_threads():
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


@pytest.mark.parametrize(
    ("call", "room", "name"),
    [(lambda log: heft.identify(log, "rocksat"), identify, "identify"), (heft.replay, replay, "_replay")],
)
def test_a_script_computes_on_a_thread_as_the_commands_do(told, monkeypatch, call, room, name):
    """Two threads of BLAS on two busy cores wait for each other: 250 s and more of a fit that takes 18 s."""
    seen = list[set[int]]()
    monkeypatch.setattr(replay, "vehicle_of", lambda *_: None)
    monkeypatch.setattr(room, name, lambda *_: seen.append(_blas_threads()))
    with threadpool_limits(2, user_api="blas"):
        call(told.path)
        assert _blas_threads() == {2}  # those of the script are its own
    assert seen == [{1}]


def test_so_does_a_command_that_a_script_calls():
    with threadpool_limits(2, user_api="blas"):
        with pytest.raises(SystemExit):
            main(["--version"])
        assert _blas_threads() == {1}
