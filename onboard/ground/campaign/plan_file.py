"""A campaign's plan.toml: what is flown or identified, with which seeds, and what differs from flight to flight.

A *factor* is something that differs: named levels, each with what it sets, or numbers for one key. A *grid* flies every
combination of all levels with every seed; a *random* design draws each seed's levels, numbers and faults from the seed
alone, so that a plan that is continued with more seeds has the same flights as before.
"""

import math
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from onboard import config
from onboard.section import NotNegative, Positive, Real, Section

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Tables = dict[str, Any]
MOST_SEEDS = 1_000_000
_PREFIXES = ("scenario", "vehicle", "settings")
_TABLES = {"mission": {"scenario", "vehicle", "mission", "faults"}, "logs": {"vehicle"}, "call": {"settings"}}


class Campaign(Section):
    """``[campaign]``. ``keep``: logs that stay: of flights that failed or were confidently wrong, of all, or none."""

    name: Annotated[str, Field(min_length=1)]
    design: Literal["grid", "random"] = "grid"
    first_seed: Annotated[int, Field(ge=0, le=2**31)] = 1
    seeds: Annotated[int, Field(ge=1, le=MOST_SEEDS)] = 1
    keep: Literal["none", "wrong", "all"] = "wrong"


class FlightSection(Section):
    """``[flight]``: exactly one of ``mission``, ``logs``, ``call``; each flight's beginning, before the factors.

    ``mission``: of ``heft hil``: a packaged mission, or a vehicle.toml. ``over``: a scenario file that lies over it.
    ``faults``: as ``heft hil --fault`` has them. ``logs``: a folder; every log below it is identified, with ``vehicle``
    in place of the one that it carries. ``call``: ``package.module:function``, called with the seed and the settings.
    """

    mission: str | None = None
    over: str | None = None
    faults: tuple[str, ...] = ()
    logs: str | None = None
    vehicle: str | None = None
    call: Annotated[str, Field(pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$")] | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        given = [key for key in ("mission", "logs", "call") if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(f"give mission, logs or call; there is {' and '.join(given) or 'none'}")
        if self.mission is None and (self.over is not None or self.faults):
            raise ValueError("over and faults go with a mission")
        if self.vehicle is not None and self.logs is None:
            raise ValueError("vehicle goes with logs; the vehicle of a mission is that of the mission")
        return self


class FactorLevel(Section):
    """``[factor.NAME.level.LEVEL]``: what a level sets. ``weight``: how often it is drawn, relative to the others."""

    weight: Positive = 1.0
    mission: str | None = None
    faults: tuple[str, ...] = ()
    scenario: Tables = Field(default_factory=dict)
    vehicle: Tables = Field(default_factory=dict)
    settings: Tables = Field(default_factory=dict)


class Factor(Section):
    """``[factor.NAME]``: either ``level`` tables, or a ``key`` with ``values``, or with a ``range``.

    ``key``: dotted, beginning with ``scenario`` (a table of the scenario), ``vehicle`` (of vehicle.toml, for the
    estimator alone) or ``settings`` (of a ``call``). ``range``: lowest and highest number; a grid takes ``steps`` of
    them, evenly spaced on ``scale``.
    """

    key: str | None = None
    values: tuple[bool | int | float | str | list[Any], ...] = ()
    range: tuple[Real, Real] | None = None
    steps: Annotated[int, Field(ge=2, le=1000)] | None = None
    scale: Literal["linear", "log"] = "linear"
    level: dict[str, FactorLevel] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        given = [name for name in ("values", "range", "level") if getattr(self, name)]
        if len(given) != 1:
            raise ValueError(f"give values, range or level; there is {' and '.join(given) or 'none'}")
        if (self.key is None) != bool(self.level):
            raise ValueError("values and range need a key; level tables have none")
        if self.key is not None and (self.key.split(".")[0] not in _PREFIXES or "." not in self.key):
            raise ValueError(f"key is scenario.TABLE.KEY, vehicle.TABLE.KEY or settings.KEY, not {self.key!r}")
        if self.range is not None:
            low, high = self.range
            if not low < high or (self.scale == "log" and low <= 0.0):
                raise ValueError("range is the lowest number, then the highest; above zero on a log scale")
        return self

    def numbers(self) -> list[float]:
        """The ``steps`` of a range."""
        assert self.range is not None
        assert self.steps is not None
        return [self.between(k / (self.steps - 1)) for k in range(self.steps)]

    def between(self, share: float) -> float:
        """The number at a share of the way through the range."""
        assert self.range is not None
        low, high = self.range
        if self.scale == "log":
            return float(math.exp(math.log(low) + share * (math.log(high) - math.log(low))))
        return float(low + share * (high - low))


class RandomFaults(Section):
    """``[faults]``: faults that a random design draws, of other devices each.

    ``count``: shares of flights with 0, 1, 2, ... of them. ``start_s``: earliest and latest beginning. ``length_s``:
    shortest and longest; ``staying``: share of those that last to the end. ``kinds``: by mission and device or bus,
    each ``KIND`` or ``KIND:VALUE``.
    """

    count: Annotated[tuple[Share, ...], Field(min_length=1)]
    start_s: tuple[NotNegative, NotNegative]
    length_s: tuple[Positive, Positive] = (0.2, 3.0)
    staying: Share = 0.0
    kinds: dict[str, dict[str, Annotated[tuple[str, ...], Field(min_length=1)]]]

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        if abs(sum(self.count) - 1.0) > 1e-6:
            raise ValueError(f"the shares in count make up {sum(self.count):g}; let them be 1")
        for key, (low, high) in (("start_s", self.start_s), ("length_s", self.length_s)):
            if low > high:
                raise ValueError(f"{key} is the least, then the most")
        for mission, devices in self.kinds.items():
            if len(devices) < len(self.count) - 1:
                raise ValueError(
                    f"{mission} has {len(devices)} devices, and count asks for {len(self.count) - 1} faults"
                )
        return self


class PlanFile(Section):
    """A whole plan. ``scenario``, ``vehicle``, ``settings``: tables of every flight, below those of the factors."""

    campaign: Campaign
    flight: FlightSection
    scenario: Tables = Field(default_factory=dict)
    vehicle: Tables = Field(default_factory=dict)
    settings: Tables = Field(default_factory=dict)
    factor: dict[str, Factor] = Field(default_factory=dict)
    faults: RandomFaults | None = None

    @model_validator(mode="after")
    def _fits_the_design(self) -> Self:
        is_grid = self.campaign.design == "grid"
        for name, factor in self.factor.items():
            if is_grid and factor.range is not None and factor.steps is None:
                raise ValueError(f"factor {name}: a grid needs the steps of its range; or let the design be random")
        if self.faults is not None and (is_grid or self.flight.mission is None):
            raise ValueError("[faults] are drawn: they need design = 'random' and a mission; a grid has them as levels")
        if self.flight.logs is not None and (self.campaign.seeds != 1 or not is_grid):
            raise ValueError("logs have no seeds: leave design and seeds out; each is identified with every level")
        self._check_tables()
        return self

    def _check_tables(self) -> None:
        kind = next(key for key in ("mission", "logs", "call") if getattr(self.flight, key) is not None)
        known = _TABLES[kind]
        used = {key for key in _PREFIXES if getattr(self, key)}
        for factor in self.factor.values():
            used |= {factor.key.split(".")[0]} if factor.key else set()
            for level in factor.level.values():
                used |= {key for key in (*_PREFIXES, "mission", "faults") if getattr(level, key)}
        if wrong := sorted(used - known):
            raise ValueError(f"a plan of {kind} has no {', '.join(wrong)}; it has {', '.join(sorted(known))}")


class CampaignPlan:
    """A plan that was read.

    Args:
        file: its tables.
        path: of plan.toml; files that it names lie beside it.
        text: of plan.toml.
    """

    def __init__(self, file: PlanFile, path: Path, text: str) -> None:
        self.file, self.path, self.text = file, path, text

    def beside(self, name: str) -> Path:
        """The path of a file that the plan names."""
        return self.path.parent / name


def read(path: Path, **over: int | None) -> CampaignPlan:
    """Read and check a plan.

    Args:
        path: of the file.
        over: keys of ``[campaign]`` in place of its own, where they are not None.

    Raises:
        ConfigError: no such file, not TOML, an unknown key or a wrong value, with its line and a remedy.
    """
    text = config.read(path, "a plan.toml")
    tree = config.tree_of(text, str(path))
    given = {key: value for key, value in over.items() if value is not None}
    if given and isinstance(tree.get("campaign"), dict):
        tree["campaign"] |= given
    return CampaignPlan(config.validated(PlanFile, tree, config.Origin(str(path), text)), path, text)
