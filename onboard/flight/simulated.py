"""Simulated runner: steps of all workers in a fixed order on a virtual clock; deterministic to the byte."""

import contextlib
import gc
from collections.abc import Callable, Iterable, Iterator
from math import ceil, gcd

from drivers.device import Device, Hurried
from onboard.flight.acquire.acquisition import Acquisition
from onboard.flight.estimate.estimation import EstimationWorker
from onboard.recording.recorder import Recorder

STEP_NS = 5_000_000  # at most
RECORDING_NS = 500_000_000  # between two steps of the recorder; rings hold many times as much
COLLECTED_EVERY = 20_000  # objects made more than given back: a flight makes hardly any cycles


class VirtualClock:
    """A clock whose time is set by the runner."""

    def __init__(self, now_ns: int) -> None:
        self.now_ns = now_ns

    def __call__(self) -> int:
        """Now [ns]."""
        return self.now_ns


@contextlib.contextmanager
def seldom_collected() -> Iterator[None]:
    """Python's collector looks at new objects only, and less often: else it takes a tenth of a flight's time."""
    before = gc.get_threshold()
    gc.freeze()
    gc.set_threshold(COLLECTED_EVERY, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)
        gc.unfreeze()


def step_ns(periods_ns: Iterable[int], longest_ns: int = STEP_NS) -> int:
    """The longest step that divides all poll periods, so that no poll is late.

    Args:
        periods_ns: of the devices; those of ``STEP_NS`` or less are polled at each step.
        longest_ns: not longer than this.
    """
    common = gcd(*(period for period in periods_ns if period > STEP_NS)) or STEP_NS
    return common // ceil(common / longest_ns)


def step_of(devices: Iterable[Device], longest_ns: int = STEP_NS) -> int:
    """``step_ns`` of devices; not longer than one that holds a single sample may wait."""
    known = list(devices)
    hurried = [device.within_ns for device in known if isinstance(device, Hurried)]
    return step_ns((device.period_ns for device in known), min([longest_ns, *hurried]))


def fly(
    clock: VirtualClock,
    end_ns: int,
    advance_world: Callable[[int], None],
    acquisition: Acquisition,
    estimation: EstimationWorker,
    recorder: Recorder,
    progress: Callable[[int], None] = lambda _: None,
    answered: Callable[[int], int | None] = lambda _: None,
) -> None:
    """Fly until ``end_ns``; then stop the devices, drain every queue and close the log.

    Args:
        clock: the virtual clock that the transports were opened with.
        end_ns: when to stop the devices.
        advance_world: brings the simulated devices to a time.
        acquisition: the acquisition worker, not started.
        estimation: the estimation worker.
        recorder: the recording worker.
        progress: called with the time after each step of the recorder.
        answered: called after each step of the estimation; returns another ``end_ns``, None to keep it.
    """
    acquisition.start(clock.now_ns)
    recorder.step(clock.now_ns)  # the log begins now
    pause_ns = step_of(acquisition.devices)
    estimation_steps, recording_steps = (
        max(1, round(period / pause_ns)) for period in (estimation.period_ns, RECORDING_NS)
    )
    start_ns, step = clock.now_ns, 0

    def handed_over(step: int) -> int:
        """The first step from ``step`` on that hands over."""
        return min(-(-step // every) * every for every in (estimation_steps, recording_steps))

    def step_at(time_ns: int) -> int:
        """The first step at a time or after it."""
        return -((start_ns - time_ns) // pause_ns)

    def handed_over_at(time_ns: int) -> int:
        """When rows found at a time are handed over."""
        return start_ns + handed_over(step_at(time_ns)) * pause_ns

    while clock.now_ns < end_ns:
        step = min(max(step + 1, step_at(acquisition.idle_until())), handed_over(step + 1))
        clock.now_ns = min(start_ns + step * pause_ns, end_ns)
        estimates, records = step % estimation_steps == 0, step % recording_steps == 0
        advance_world(clock.now_ns)
        acquisition.step(clock.now_ns, hand_over=estimates or records, handed_over_at=handed_over_at)
        if estimates:
            estimation.step(clock.now_ns)
            end_ns = min(end_ns, answered(clock.now_ns) or end_ns)
        if records:
            recorder.step(clock.now_ns)
            progress(clock.now_ns)
    acquisition.stop(clock.now_ns)
    estimation.finish(clock.now_ns)
    if recorder.close(clock.now_ns).failing:
        recorder.abandon()
