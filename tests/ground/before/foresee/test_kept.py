"""Results kept in the user's cache: given back to the bit, made again for another input, and never believed blindly."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from onboard import config
from onboard.dynamics.model.inertia import RigidBody
from onboard.ground.before.foresee import kept as module
from onboard.ground.before.foresee.kept import kept
from onboard.ground.before.foresee.plan import Expected, Foreseen, MotionPlan
from onboard.identification.standing import Level
from onboard.regressor.rows import BaseMotion

_MASS = Expected("mass_payload", "kg", 0.1 + 0.2, 1.0 / 3.0, Level.GOOD)
_DRAG = Expected("drag_1", "N s/m", 0.0, float("nan"), Level.WEAK, "not determined")
_ROCKSAT = config.named("rocksat")
_PAYLOAD = RigidBody(0.3, np.array([0.1, 0.2, 1.0 / 3.0]), np.eye(3) / 7.0)


def _plan(**changed):
    numbers = np.linspace(0.0, 1.0, 10)
    base = BaseMotion(*np.ones((3, 10, 3)))
    held = np.ones(10, np.bool_)
    motion = numbers[:, None], numbers[:, None], numbers[:, None], np.zeros(10, np.intp), held
    return MotionPlan(numbers, *motion, (base,), np.zeros(3), np.zeros(3), _PAYLOAD)._replace(**changed)


class _Bound:
    """Gives one result, and counts how often it is asked."""

    def __init__(self, payload=_PAYLOAD):
        self.result, self.asked = Foreseen((_MASS,), (_DRAG,), payload, 9.75, ("it hardly turns",)), 0

    def __call__(self):
        self.asked += 1
        return self.result


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "heft" / "foreseen"


def _asked(bound, plan=None, vehicle=None):
    """How often the bound was asked by one call; what comes is always the same."""
    before = bound.asked
    found = kept(vehicle or _ROCKSAT, plan or _plan(), bound)
    assert repr(found) == repr(bound.result)
    return bound.asked - before


@pytest.mark.parametrize("payload", [_PAYLOAD, None])
def test_the_same_input_is_computed_once(cache, payload):
    bound = _Bound(payload)
    assert [_asked(bound) for _ in range(3)] == [1, 0, 0]
    (file,) = cache.iterdir()
    assert file.stat().st_mode & 0o777 == 0o600
    assert cache.stat().st_mode & 0o777 == 0o700


def test_another_vehicle_motion_or_version_is_another_result(cache, monkeypatch):
    bound = _Bound()
    assert _asked(bound) == 1
    q = np.linspace(0.0, 1.0, 10)[:, None].copy()
    q[3] = np.nextafter(q[3], 1.0)
    assert _asked(bound, _plan(q=q)) == 1
    assert _asked(bound, _plan(bases=())) == 1
    assert _asked(bound, vehicle=_ROCKSAT.with_row_rate(40.0)) == 1
    assert _asked(bound, vehicle=config.named("capture")) == 1
    monkeypatch.setattr(module, "_code", lambda: ["another"])
    assert _asked(bound) == 1
    assert len(list(cache.iterdir())) == 6


def _damage(file, how):
    text = file.read_bytes()
    if how == "cut":
        file.write_bytes(text[:-10])
    elif how == "flipped":
        file.write_bytes(text[:100] + bytes([text[100] ^ 1]) + text[101:])
    elif how == "empty":
        file.write_bytes(b"")
    elif how == "huge":
        file.write_bytes(text + b" " * (1 << 20))
    elif how == "link":
        file.rename(file.with_name("elsewhere"))
        file.symlink_to(file.with_name("elsewhere"))
    elif how == "pipe":
        file.unlink()
        os.mkfifo(file)
    elif how == "writable":
        file.chmod(0o666)


@pytest.mark.parametrize("how", ["cut", "flipped", "empty", "huge", "link", "pipe", "writable"])
def test_a_damaged_file_is_made_again_and_replaced(cache, how):
    bound = _Bound()
    assert _asked(bound) == 1
    (file,) = cache.iterdir()
    _damage(file, how)
    assert [_asked(bound), _asked(bound)] == [1, 0]
    assert file.is_file()
    assert not file.is_symlink()


@pytest.mark.parametrize(
    "crafted",
    [
        b"[" * 100_000,
        b"{}",
        json.dumps({"quantities": [], "parameters": [], "payload": None, "span_s": 1.0, "words": ["\x1b[2J"]}).encode(),
        json.dumps({"quantities": 3, "parameters": [], "payload": None, "span_s": "x", "words": []}).encode(),
    ],
)
def test_a_crafted_file_whose_digest_fits_is_not_believed(cache, crafted):
    bound = _Bound()
    assert _asked(bound) == 1
    (file,) = cache.iterdir()
    file.write_bytes(module.hashlib.sha256(crafted).hexdigest().encode() + b"\n" + crafted)
    assert [_asked(bound), _asked(bound)] == [1, 0]


def test_a_directory_that_others_may_write_is_left_alone(cache):
    cache.mkdir(parents=True)
    cache.chmod(0o777)
    bound = _Bound()
    assert [_asked(bound), _asked(bound)] == [1, 1]
    assert list(cache.iterdir()) == []


def test_without_a_cache_it_is_made_each_time(tmp_path, monkeypatch):
    """A file in the directory's place."""
    (tmp_path / "heft").write_text("mine")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    bound = _Bound()
    assert [_asked(bound), _asked(bound)] == [1, 1]
    assert Path(tmp_path / "heft").read_text() == "mine"


def test_the_oldest_of_many_are_thrown_away(cache, monkeypatch):
    assert module._MOST_FILES == 64
    monkeypatch.setattr(module, "_MOST_FILES", 8)
    bound = _Bound()
    for number in range(14):
        _asked(bound, _plan(velocity_m_s=np.full(3, float(number))))
    assert len(list(cache.iterdir())) == 8
    assert _asked(bound, _plan(velocity_m_s=np.full(3, 13.0))) == 0
