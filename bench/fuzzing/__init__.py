"""Fuzzing of every decoder, and of what reads files: its parts. ``bench/fuzz.py`` is the command."""

from collections.abc import Callable
from typing import NamedTuple

DECODERS = (
    *("mpu6050", "canopen", "slcan", "nimu", "qsb", "modbus", "dsc", "dynamixel", "node_frame", "sync_pulse"),
    "bota_ft",
)
I2C = ("nau7802", "as5600", "as5048", "icm20948", "bmi088", "bmi088_spi")
LINES = ("hx711",)
AXES = ("odrive",)
WRISTS = ("robotous_rft",)
FILES = ("vehicle", "urdf", "segments", "log", "recover", "import")
NAMES = DECODERS + I2C + LINES + AXES + WRISTS + FILES


class Target(NamedTuple):
    """A decoder, or what reads a file, under fuzz.

    Attributes:
        call: What is called.
        seeds: Valid inputs.
        most_bytes: Longest input.
    """

    call: Callable[[bytes], None]
    seeds: list[bytes]
    most_bytes: int


def target(name: str) -> Target:
    """One of them. Imports what it is of: an engine that instruments that calls this while it does so."""
    if name in FILES:
        from bench.fuzzing import file_seeds, files  # noqa: PLC0415

        return Target(files.CALLS[name], file_seeds.seeds()[name], 1 << 15)
    if name in I2C:
        from bench.fuzzing import i2c  # noqa: PLC0415

        return Target(i2c.CALLS[name], i2c.SEEDS, 1 << 10)
    if name in AXES:
        from bench.fuzzing import axes  # noqa: PLC0415

        return Target(axes.odrive, axes.SEEDS, 1 << 10)
    if name in WRISTS:
        from bench.fuzzing import wrist  # noqa: PLC0415

        return Target(wrist.robotous, wrist.SEEDS, 1 << 10)
    if name in LINES:
        from bench.fuzzing import lines  # noqa: PLC0415

        return Target(lines.hx711_chip, lines.SEEDS, 1 << 10)
    from bench.fuzzing import decoders, seeds  # noqa: PLC0415

    return Target(decoders.CALLS[name], seeds.seeds()[name], 1 << 10)
