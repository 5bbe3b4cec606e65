"""Fuzzing of every decoder: its parts. ``bench/fuzz.py`` is the command."""

from collections.abc import Callable
from typing import NamedTuple

NAMES = ("mpu6050", "canopen", "slcan", "nimu", "qsb", "modbus", "dsc", "node_frame", "sync_pulse")


class Target(NamedTuple):
    """A decoder under fuzz: what is called, and valid inputs."""

    call: Callable[[bytes], None]
    seeds: list[bytes]


def targets() -> dict[str, Target]:
    """All of them, by name. Imports ``drivers``: an engine that instruments them calls this while it does so."""
    from bench.fuzzing import decoders, seeds  # noqa: PLC0415

    valid = seeds.seeds()
    return {name: Target(decoders.CALLS[name], valid[name]) for name in NAMES}
