"""``heft.subscribe``: rows of a flight that is running, until it ends."""

import numpy as np
import pytest

import heft
from onboard.channels import QUANTITY
from onboard.flight.store import directories, manifest
from onboard.recording.segmented import Preamble
from onboard.ring import RingWriter


def answers(first, count):
    rows = np.zeros(count, QUANTITY)
    rows["sequence"], rows["name"] = np.arange(first, first + count), b"m_payload"
    return rows


@pytest.fixture
def flight(tmp_path, monkeypatch):
    """A running flight's log and the writing end of its answers."""
    monkeypatch.setenv("HEFT_RINGS", str(tmp_path / "rings"))
    log = tmp_path / "flight.mcap"
    with manifest.new_flight(log, "test-sub") as directory:
        pass
    with directories.belong(directory):
        about = manifest.Manifest(directory, log, "mine", manifest.Storage(1, 1, 1, 0), Preamble("test-sub", (), {}))
        about.save()
        yield log, RingWriter(directory / "quantity.ring", QUANTITY, 100), about.remove


def test_rows_come_as_they_are_made_and_end_with_the_flight(flight):
    log, ring, end = flight
    ring.push(answers(0, 3))  # before anybody subscribed
    for which in ((), ("quantity", log)):
        stream = heft.subscribe(*which)
        first = ring.published
        ring.push(answers(first, 2))
        assert next(stream)["sequence"].tolist() == [first, first + 1]
        ring.push(answers(first + 2, 150))
        assert next(stream)["sequence"].tolist() == list(range(first + 52, first + 152))
    end()
    assert list(stream) == []


def test_a_flight_that_died_ends_the_stream(flight, monkeypatch):
    stream = heft.subscribe()
    monkeypatch.setattr(directories, "is_free", lambda _: True)
    assert list(stream) == []


def test_what_is_not_there_is_said(flight, tmp_path):
    with pytest.raises(ValueError, match="no channel 'mass'; its channels are quantity"):
        heft.subscribe("mass")
    with pytest.raises(ValueError, match="no flight is recorded to"):
        heft.subscribe(log=tmp_path / "other.mcap")
    flight[2]()
    with pytest.raises(ValueError, match="start heft fly first"):
        heft.subscribe()
