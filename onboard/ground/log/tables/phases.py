"""Phases of a flight from its phase channel, timed by arrival (error of some milliseconds)."""

from typing import NamedTuple

from drivers.records import SCALAR
from onboard import config
from onboard.recording.reader import LogReader


class Phase(NamedTuple):
    """One phase: ``start_ns`` to ``end_ns`` (not included) of the recording host's clock.

    ``name`` follows the vehicle file: ``sweep 1``, ``sweep 2`` in flown order for identification phases, ``release``,
        ``end``, else ``phase CODE``.
    """

    start_ns: int
    end_ns: int
    code: int
    name: str
    sweep: bool


def phases_of(log: LogReader, settings: config.Phases | None, end_ns: int) -> tuple[Phase, ...]:
    """The phases in ``log``; none without a phase channel.

    Args:
        log: a flight's log.
        settings: phase codes of the vehicle file.
        end_ns: end of the last phase.
    """
    if settings is None or log.channels.get(settings.channel) != SCALAR:
        return ()
    changes: list[tuple[int, int]] = []
    for _, rows in log.batches([settings.channel]):
        for at_ns, code in zip(rows["host_ns"].tolist(), rows["value_raw"].tolist(), strict=True):
            if not changes or changes[-1][1] != code:
                changes.append((at_ns, code))
    ends = [*(at_ns for at_ns, _ in changes), end_ns][1:]
    phases: list[Phase] = []
    named = {settings.payload_gone: "release", settings.end: "end"}
    for (start_ns, code), stop_ns in zip(changes, ends, strict=True):
        sweep = code in settings.identify
        number = sum(phase.sweep for phase in phases) + 1
        name = f"sweep {number}" if sweep else named.get(code, f"phase {code}")
        phases.append(Phase(start_ns, stop_ns, code, name, sweep))
    return tuple(phases)
