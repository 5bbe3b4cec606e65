"""Faults as data: kind, device, start and end; the kinds are listed in ``vocabulary``."""

from hil_sim.faults.inputs import FaultyImu, FaultyScalar, reported_phases
from hil_sim.faults.oscillator import FaultyClock
from hil_sim.faults.plan import NEVER, NO_FAULTS, DeviceFaults, FaultPlan, PowerCycle, garbled
from hil_sim.faults.vocabulary import (
    CLOCK_KINDS,
    EFFECTS,
    ENCODER_KINDS,
    INPUT_KINDS,
    MEMORYLESS,
    Fault,
    FaultError,
    FaultKind,
    parse,
)

__all__ = [
    "CLOCK_KINDS",
    "EFFECTS",
    "ENCODER_KINDS",
    "INPUT_KINDS",
    "MEMORYLESS",
    "NEVER",
    "NO_FAULTS",
    "DeviceFaults",
    "Fault",
    "FaultError",
    "FaultKind",
    "FaultPlan",
    "FaultyClock",
    "FaultyImu",
    "FaultyScalar",
    "PowerCycle",
    "garbled",
    "parse",
    "reported_phases",
]
