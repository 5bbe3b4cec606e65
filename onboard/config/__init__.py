"""Reads vehicle.toml into frozen objects. Units are in the keys; unknown keys are refused with line and remedy."""

from onboard.config.bases.free_body import Load
from onboard.config.checks import with_urls
from onboard.config.errors import ConfigError, Origin
from onboard.config.estimation import ImuPriorKeys, JointKeys, Phases, Prior, Zero
from onboard.config.loader import devices_alone, load, named, packaged, parse, parse_tree, validated, with_mission
from onboard.config.methods import PREDICTING, Prediction
from onboard.config.text import laid_over, read, tree_of
from onboard.config.vehicle import RecordingSection, Vehicle

__all__ = [
    "PREDICTING",
    "ConfigError",
    "ImuPriorKeys",
    "JointKeys",
    "Load",
    "Origin",
    "Phases",
    "Prediction",
    "Prior",
    "RecordingSection",
    "Vehicle",
    "Zero",
    "devices_alone",
    "laid_over",
    "load",
    "named",
    "packaged",
    "parse",
    "parse_tree",
    "read",
    "tree_of",
    "validated",
    "with_mission",
    "with_urls",
]
