"""Reads vehicle.toml into frozen objects. Units are in the keys; unknown keys are refused with line and remedy."""

from onboard.config.errors import ConfigError
from onboard.config.estimation import Phases, Zero
from onboard.config.free_body import Load
from onboard.config.loader import load, named, packaged, parse
from onboard.config.vehicle import Recording, Vehicle

__all__ = ["ConfigError", "Load", "Phases", "Recording", "Vehicle", "Zero", "load", "named", "packaged", "parse"]
