"""Functions that plans of the tests call: an answer drawn from the seed, at once or after a while."""

import os
import time
import weakref
from typing import Any

import numpy as np

from onboard.ground.campaign.results import FlightAnswer, FlightResult


def drawn(seed: int, settings: dict[str, Any]) -> FlightResult:
    """A mass with an error of sigma ``spread``, plus ``bias``; each flight leaves a line in the file ``flown``."""
    time.sleep(settings.get("seconds", 0.0))
    if "flown" in settings:
        with open(settings["flown"], "a", encoding="ascii") as file:
            file.write(f"{seed}\n")
    if seed in settings.get("fails", ()):
        raise RuntimeError(f"seed {seed} does not fly")
    if seed in settings.get("kills", ()):
        os.kill(os.getpid(), 9)
    rng = np.random.default_rng(seed)
    spread, truth = settings.get("spread", 0.01), 1.0 + float(rng.random())
    value = truth + settings.get("bias", 0.0) + spread * float(rng.standard_normal())
    sigma = settings.get("sigma", spread)
    interval = {"value": value, "low": value - 1.96 * sigma, "high": value + 1.96 * sigma, "sigma": sigma}
    told = FlightAnswer(
        "m", "kg", truth, **interval, bound=0.9 * sigma, supported=True, level=settings.get("level", "good")
    )
    return FlightResult((told,), faults=tuple(settings.get("faults", ())), unseen=settings.get("unseen", False))


class World:
    """One that refers to itself, as simulated worlds do."""

    last: "weakref.ref[World]"

    def __init__(self) -> None:
        self.itself = self


def in_a_world(seed: int, settings: dict[str, Any]) -> FlightResult:
    """As :func:`drawn`, in a world."""
    World.last = weakref.ref(World())
    return drawn(seed, settings)
