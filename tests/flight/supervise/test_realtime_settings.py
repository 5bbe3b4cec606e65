"""``[realtime]``: what a worker asks the system for, what it says of it, and what a vehicle file may ask."""

import errno
import gc
import os

import pytest

from drivers.records import Severity
from onboard import config
from onboard.config.vehicle import Realtime
from onboard.flight.health.status import Status
from onboard.flight.supervise import realtime
from onboard.flight.supervise.realtime import UNCHANGED, Settings, System, apply, settings


class _Asked:
    """A system that notes what it is asked for and refuses some of it."""

    def __init__(self, *refuses: str) -> None:
        self.calls: list[tuple[str, object]] = []
        self._refuses = refuses

    def system(self) -> System:
        return System(
            lambda priority: self._note("priority", priority),
            lambda cpus: self._note("cpus", cpus),
            lambda: self._note("memory", True),
        )

    def _note(self, what: str, value: object) -> None:
        self.calls.append((what, value))
        if what in self._refuses:
            raise OSError(errno.EPERM, os.strerror(errno.EPERM))


EVERYTHING = Settings(50, (1, 3), lock_memory=True, freeze=False, by_file=True)


def test_all_granted() -> None:
    asked = _Asked()
    has = apply(EVERYTHING, asked.system())
    assert asked.calls == [("memory", True), ("cpus", (1, 3)), ("priority", 50)]
    assert has.said() == (Severity.INFO, "realtime", "has locked memory, CPU 1,3, SCHED_FIFO 50")
    assert has.status == Status(0)


def test_each_refusal_is_named_with_its_remedy_and_the_rest_is_asked_for() -> None:
    asked = _Asked("priority", "memory")
    has = apply(EVERYTHING, asked.system())
    assert len(asked.calls) == 3
    severity, code, text = has.said() or (None, "", "")
    assert (severity, code, has.status) == (Severity.WARNING, "not_realtime", Status.NOT_REALTIME)
    assert text == (
        "has CPU 1,3; refused: locked memory (Operation not permitted): LimitMEMLOCK=infinity in deploy/heft.service, "
        "or ulimit -l unlimited; SCHED_FIFO 50 (Operation not permitted): LimitRTPRIO=50 in deploy/heft.service, "
        "or ulimit -r 50"
    )


def test_a_default_that_is_refused_is_no_warning() -> None:
    wanted = settings(Realtime(), "acquisition")
    assert wanted == Settings(50, (), lock_memory=False, freeze=True, by_file=False)
    has = apply(wanted._replace(freeze=False), _Asked("priority").system())
    severity, code, text = has.said() or (None, "", "")
    assert (severity, code, has.status) == (Severity.INFO, "not_realtime", Status(0))
    assert text.startswith("has nothing that it asked for; refused: SCHED_FIFO 50 (")


def test_who_asks_for_what() -> None:
    table = Realtime(recording_priority=10, recording_cpus=[2], lock_memory=True)
    assert settings(table, "recording") == Settings(10, (2,), lock_memory=True, freeze=True, by_file=True)
    assert settings(table, "acquisition") == Settings(50, (), lock_memory=True, freeze=True, by_file=True)
    assert settings(table, "estimation") == Settings(0, (), lock_memory=False, freeze=True, by_file=False)
    assert settings(Realtime(), "recording") == Settings(0, (), lock_memory=False, freeze=True, by_file=False)
    assert apply(UNCHANGED, _Asked("priority", "cpus", "memory").system()).said() is None


def test_the_collector_is_frozen() -> None:
    gc.unfreeze()
    try:
        apply(UNCHANGED._replace(freeze=True), _Asked().system())
        assert gc.get_freeze_count() > 1000
    finally:
        gc.unfreeze()


def test_the_kernel_is_asked_for_cores_that_are_not_there() -> None:
    before = os.sched_getaffinity(0)
    has = apply(UNCHANGED._replace(cpus=(1023,)))
    assert has.granted == ()
    assert has.refused[0].startswith(f"CPU 1023 (Invalid argument): it may use {min(before)}")
    assert os.sched_getaffinity(0) == before


def test_a_finite_limit_of_locked_memory_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(realtime.os, "geteuid", lambda: 1000)
    monkeypatch.setattr(realtime.resource, "getrlimit", lambda _: (8 << 20, 8 << 20))
    [refused] = apply(UNCHANGED._replace(lock_memory=True)).refused
    assert refused.startswith("locked memory (the limit is 8192 kB): LimitMEMLOCK=infinity")


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("recording_priority = 50", "recording would delay acquisition"),
        ("acquisition_priority = 0\nrecording_priority = 1", "recording would delay acquisition"),
        ("acquisition_priority = 100", "99 or less"),
        ("acquisition_cpus = [-1]", "0 or more"),
        ("acquisition_cpus = [1.5]", "a whole number"),
        ("lock_memory = 3", "true or false"),
        ("cpus = [1]", "cpus"),
    ],
)
def test_what_a_vehicle_file_may_not_ask(table: str, said: str) -> None:
    rocksat = config.named("rocksat")
    assert config.parse(f"{rocksat.text}\n[realtime]\nacquisition_cpus = [0]\n", rocksat.path)
    with pytest.raises(config.ConfigError, match=said):
        config.parse(f"{rocksat.text}\n[realtime]\n{table}\n", rocksat.path)
