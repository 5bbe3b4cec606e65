"""What the operator does at each step of a live calibration, and for how long it is then left alone."""

from collections.abc import Sequence
from typing import NamedTuple


class GuideStep(NamedTuple):
    """One step: shown, confirmed with Enter, left alone for ``hold_s``, and marked in the log as ``name``."""

    name: str
    text: str
    hold_s: float


def imu(turn_deg: float, allan_s: float) -> list[GuideStep]:
    """Six faces, and on each a turn and back."""
    steps = []
    for axis in "xyz":
        for sign in "+-":
            face = f"{sign}{axis}"
            steps += [
                GuideStep(f"{face} up", f"Lay the IMU still with its {face} axis up.", 10.0),
                GuideStep(
                    f"{face} turned", f"Turn it about the vertical by {turn_deg:g} deg, and leave it still.", 4.0
                ),
                GuideStep(f"{face} back", "Turn it back by the same angle, and leave it still.", 4.0),
            ]
    if allan_s:
        steps.append(GuideStep("rest", f"Leave it alone for {allan_s:g} s.", allan_s))
    return steps


def masses(masses_kg: Sequence[float]) -> list[GuideStep]:
    """One mass after the other."""
    told = [f"Hang {kg:g} kg" if kg else "Take everything off" for kg in masses_kg]
    return [
        GuideStep(f"{kg:g} kg", f"{text}, and wait until it hangs still.", 8.0)
        for kg, text in zip(masses_kg, told, strict=True)
    ]


def stops(angles_deg: Sequence[float]) -> list[GuideStep]:
    """One stop after the other."""
    return [
        GuideStep(f"{a:g} deg", f"Push the joint against its stop at {a:g} deg, and hold it there.", 4.0)
        for a in angles_deg
    ]


def swings() -> list[GuideStep]:
    """One axis after the other."""
    which = ("x", "y", "z", "between x and y", "between x and z", "between y and z")
    return [
        GuideStep(
            f"swing {number}",
            f"Hang the body with an axis vertical that it has not had yet ({axis}), turn it by some 25 "
            "deg, let it go without a push, and press Enter when it swings freely.",
            40.0,
        )
        for number, axis in enumerate(which, 1)
    ]


def orientations(count: int) -> list[GuideStep]:
    """Unloaded, then one orientation after the other."""
    bare = GuideStep("unloaded", "Lift the body off the cell.", 6.0)
    return [bare] + [
        GuideStep(f"orientation {n + 1}", f"Lay the body as orientation {n + 1} of the rig file has it.", 6.0)
        for n in range(count)
    ]
