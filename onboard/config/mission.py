"""``[mission]``: what the flight is to find out, and the motions that it may ask for meanwhile."""

import re
from dataclasses import dataclass

from pydantic import field_validator

from onboard.section import NotNegative, Positive, Section

_PART = re.compile(r"([A-Za-z]\w*) +([0-9.eE+-]+) *(\S.*)?")
_UNITS = {"%": ("", 0.01), "kg": ("kg", 1.0), "g": ("kg", 1e-3), "m": ("m", 1.0), "mm": ("m", 1e-3)}
_UNITS["kg m^2"] = ("kg m^2", 1.0)
GROUPS = {"mass": "m", "centre": "c", "inertia": "I"}


@dataclass(frozen=True)
class Goal:
    """How narrow an interval is to be: half of the 95 % one, of every quantity that ``name`` means."""

    name: str  # mass, centre, inertia, or a quantity's
    half: float
    unit: str  # empty: a share of its size: the mass, the radius of gyration, half the inertia's trace

    def names(self, quantities: tuple[str, ...]) -> tuple[str, ...]:
        """The quantities that it means."""
        first = GROUPS.get(self.name, self.name)
        return tuple(name for name in quantities if name == first or name.startswith(f"{first}_"))


def goals_of(text: str) -> tuple[Goal, ...]:
    """``"mass 1 %, centre 5 mm"`` as goals.

    Raises:
        ValueError: it says something else.
    """
    goals = []
    for part in text.split(","):
        found = _PART.fullmatch(part.strip())
        unit = None if found is None else _UNITS.get((found[3] or "").strip())
        try:
            value = float(found[2]) if found is not None else 0.0
        except ValueError:
            value = 0.0
        if found is None or unit is None or not 0.0 < value < 1e6:
            raise ValueError(
                f'{part.strip()!r}: write WHAT NUMBER UNIT, e.g. "mass 1 %, centre 5 mm"; units are %, kg, '
                "g, m, mm, kg m^2"
            )
        goals.append(Goal(found[1], value * unit[1], unit[0]))
    return tuple(goals)


class MissionKeys(Section):
    """What a flight is to find out; see docs/planning.md.

    ``until``: half of the 95 % intervals that are enough: ``"mass 1 %, centre 5 mm"``. ``segments``: the file of
    motions that it may ask for (``heft plan --segments``). ``give_up_s``: longest time with a payload held.
    ``probe_s``: a flight that begins with nothing held asks for a small motion after so long a rest, five times at
    most; 0: never.
    """

    until: str
    segments: str
    give_up_s: Positive = 600.0
    probe_s: NotNegative = 10.0

    @field_validator("until")
    @classmethod
    def _is_goal(cls, text: str) -> str:
        goals_of(text)
        return text
