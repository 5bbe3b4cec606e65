"""The state of an estimator as data: it comes back to the bit, and nothing in a file makes anything run."""

import json
import pickle
import struct
import zlib
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from onboard import config
from onboard.estimation.gates import GateReason
from onboard.flight.estimate import checkpoint
from onboard.flight.estimate.checkpoint import Checkpoint, Checkpoints
from onboard.flight.estimate.estimator import Estimator
from onboard.flight.estimate.state import FORMAT, StateError, UnwrittenParts, from_bytes
from onboard.identification.free_flyer.online import MotionIdentifier
from onboard.identification.rows.hypotheses import Hypotheses
from tests.flight.estimate.state_bytes import to_bytes

NOTHING = UnwrittenParts(None)


def test_values_come_back_with_their_kinds_and_what_they_share() -> None:
    shared = np.arange(6.0).reshape(2, 3)
    made: dict[Any, Any] = {
        ("a", 1): [shared, shared, None, True, 2**80, -0.0, float("inf"), b"\x00\xff"],
        "f": np.asfortranarray(shared),
        "s": {1, 2},
        "q": deque([1.5], maxlen=3),
        "e": GateReason.CONTACT,
        "g": np.float32(0.1),
        "z": slice(1, None, 2),
        "r": np.array([(1, [2.0, 3.0]), (4, [5.0, 6.0])], np.dtype([("n", "<u4"), ("x", "<f8", (2,))], align=True)),
        "0": np.zeros((0, 3)),
    }
    made["self"] = made
    back = from_bytes(to_bytes(made, NOTHING), NOTHING)
    first = back["a", 1]
    assert first[0] is first[1]
    assert back["self"] is back
    assert first[2:] == made["a", 1][2:]
    assert np.signbit(first[5])
    assert back["f"].flags.f_contiguous
    assert (type(back["g"]), back["g"]) == (np.float32, np.float32(0.1))
    assert (back["q"], back["q"].maxlen, back["s"], back["z"]) == (deque([1.5]), 3, {1, 2}, slice(1, None, 2))
    assert back["r"].dtype == made["r"].dtype
    assert (back["r"] == made["r"]).all()
    assert back["0"].shape == (0, 3)
    back["f"][0, 0] = 1.0  # it can be written to
    assert back["e"] is GateReason.CONTACT


def test_what_cannot_be_written_to_is_not_written_but_found_in_the_new_object() -> None:
    sealed, loose = np.arange(1000.0), np.arange(1000.0)
    sealed.setflags(write=False)
    places = UnwrittenParts([sealed, loose])
    data = to_bytes([sealed, loose], places)
    assert loose.nbytes < len(data) < 1.5 * loose.nbytes
    back = from_bytes(data, places)
    assert back[0] is sealed
    assert back[1] is not loose
    assert (back[1] == loose).all()


class _Foreign:
    pass


@pytest.mark.parametrize("thing", [_Foreign(), print, Path("x"), np.array([_Foreign()], object), pickle.Pickler])
def test_what_is_not_data_is_refused(thing: object) -> None:
    with pytest.raises((StateError, ValueError)):
        to_bytes([thing], NOTHING)


def crafted(tree: object, form: int = FORMAT) -> bytes:
    text = json.dumps(tree).encode()
    return struct.pack("<8sIIQQ", b"heftstat", form, zlib.crc32(text), len(text), 0) + text + bytes(64)


@pytest.mark.parametrize(
    "tree",
    [
        ["object", "os:system", {}],
        ["object", "subprocess:Popen", {"args": "true"}],
        ["object", "onboard.flight.estimate.checkpoint:pickle", {}],
        ["object", "onboard.flight.estimate.checkpoint:Path", {}],
        ["object", "onboard.flight.no_such_module:Thing", {}],
        ["enum", "builtins:eval", "1"],
        ["record", "builtins:tuple", []],
        ["at", "/somewhere"],
        ["same", 99],
        ["array", 0],
        ["array", "|O", "C", [2], 0],
        ["array", [["a", "|O"]], "C", [2], 0],
        ["array", "<f8", "C", [9], 0],
        ["array", "<f8", "C", [-1], 0],
        ["array", "<f8", "C", [1], -8],
        ["array", "<f8", "C", [1 << 62], 0],
        ["unheard", 1],
        [],
        {"a": 1},
    ],
)
def test_a_crafted_tree_is_refused(tree: object) -> None:
    with pytest.raises(StateError):
        from_bytes(crafted(tree), NOTHING)


def test_damaged_files_and_pickles_are_refused(rng: np.random.Generator) -> None:
    whole = to_bytes([np.arange(40.0), {"a": 1}], NOTHING)
    assert len(from_bytes(whole, NOTHING)) == 2
    for data in (b"", pickle.dumps([1]), whole[:-30], whole[: len(whole) // 2]):
        with pytest.raises(StateError):
            from_bytes(data, NOTHING)
    for _ in range(100):
        bent = bytearray(whole)
        bent[rng.integers(len(bent))] ^= 1 << rng.integers(8)
        with pytest.raises(StateError):
            from_bytes(bytes(bent), NOTHING)
    assert from_bytes(crafted(["plain", [1]]), NOTHING) == (1,)
    with pytest.raises(StateError, match="format 3, not 4"):
        from_bytes(crafted(["plain", [1]], FORMAT - 1), NOTHING)


@pytest.mark.parametrize("name", ["rocksat", "dymaflex", "dymaflex_air_bearing", "workshop"])
def test_a_new_estimator_of_every_kind_can_be_written(name: str, tmp_path: Path) -> None:
    vehicle = config.load(config.packaged(name))
    estimator = Estimator(vehicle)
    Checkpoints(tmp_path, UnwrittenParts(estimator)).save(Checkpoint(0, 0, {}, estimator))
    other = Estimator(vehicle)
    back = Checkpoints(tmp_path, UnwrittenParts(other)).load()
    assert back is not None
    assert back.estimator.model is other.model
    assert back.estimator.online.parameter_names == estimator.online.parameter_names
    assert Checkpoints(tmp_path, UnwrittenParts(other)).load() is None  # it was tried, and came to nothing


def test_an_identifier_for_a_release_that_may_not_have_happened_shares_the_model() -> None:
    estimator = Estimator(config.load(config.packaged("rocksat")))
    places = UnwrittenParts(estimator)
    assert isinstance(estimator.online, Hypotheses)
    before = len(to_bytes(estimator, places))
    estimator.online._divide()
    assert len(to_bytes(estimator, places)) > before


def test_a_file_that_holds_something_else_is_no_checkpoint(tmp_path: Path) -> None:
    estimator = Estimator(config.load(config.packaged("workshop")))
    checkpoints = Checkpoints(tmp_path, UnwrittenParts(estimator))
    for thing in ([1], (1, 2), (0, 0, {}, "estimator")):
        (tmp_path / "estimator.checkpoint").write_bytes(to_bytes(thing, NOTHING))
        with pytest.raises(StateError):
            checkpoints.load()


def test_checkpoints_take_turns_in_the_memory_of_two_files(tmp_path: Path) -> None:
    vehicle = config.load(config.packaged("workshop"))
    estimator = Estimator(vehicle)
    checkpoints = Checkpoints(tmp_path, UnwrittenParts(estimator))
    of_each = []
    for ticks in range(6):
        held = {
            "a name": [0] * (50 if ticks == 4 else 5000)
        }  # the fifth is shorter than the third, in whose place it is
        checkpoints.save(Checkpoint(ticks, 0, held, estimator))
        of_each.append([path.stat().st_ino for path in sorted(tmp_path.glob("estimator.*"))])
        again = checkpoints.load()
        assert again is not None
        assert again.ticks == ticks
        assert again.positions == held
        checkpoints.taken_over()
    assert len({*of_each[1]}) == 2
    assert of_each[1:] == [of_each[1], of_each[1][::-1]] * 2 + [of_each[1]]


def test_what_never_changes_of_a_free_flyers_estimator_is_not_in_a_checkpoint() -> None:
    estimator = Estimator(config.load(config.packaged("dymaflex")))
    assert isinstance(estimator.online, MotionIdentifier)
    unknowns = len(estimator.online.ekf.predictor.names)
    assert unknowns > 100
    size = len(to_bytes(estimator.online, UnwrittenParts(estimator)))
    assert size < 1.5 * 8 * unknowns**2  # its covariance, of which the prior is a copy


def test_where_two_files_cannot_exchange_their_names_a_checkpoint_takes_the_place_of_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a network's file system: the kernel does not know the flag there."""
    monkeypatch.setattr(checkpoint, "_RENAME_EXCHANGE", 1 << 20)
    estimator = Estimator(config.load(config.packaged("workshop")))
    checkpoints = Checkpoints(tmp_path, UnwrittenParts(estimator))
    for ticks in range(3):
        checkpoints.save(Checkpoint(ticks, 0, {}, estimator))
    back = checkpoints.load()
    assert back is not None
    assert back.ticks == 2
