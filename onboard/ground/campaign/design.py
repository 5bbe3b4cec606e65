"""From a plan to its items: one flight or log each, with everything that its result depends on but the code."""

import hashlib
import itertools
import json
import os
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from onboard import config
from onboard.config.text import MOST_BYTES_URDF
from onboard.ground.campaign.plan_file import CampaignPlan, Factor, RandomFaults
from onboard.recording.format.segments import flights

Tables = dict[str, Any]
Point = dict[str, str | float]  # level or number by factor
_DEPTH = "v/v/v/v"  # of the folder a vehicle file is laid out in: its URDF may lie in a folder above it
_CHUNK = 1 << 22  # bytes of a log read at a time


@dataclass(frozen=True)
class Item:
    """What one worker does, and all that it needs for it.

    Attributes:
        seed: of everything random.
        point: where in the design it stands.
        mission: packaged mission, or path of a vehicle.toml among ``files``.
        log: path of a log to identify, and ``digest`` of its content.
        call: function that flies.
        faults: as ``heft hil --fault`` has them.
        scenario, vehicle, settings: tables laid over those of the mission, or handed to the function.
        files: texts by path.
        keep: whether its log stays.
    """

    seed: int
    point: Point = field(default_factory=dict)
    mission: str = ""
    log: str = ""
    digest: str = ""
    call: str = ""
    faults: tuple[str, ...] = ()
    scenario: Tables = field(default_factory=dict)
    vehicle: Tables = field(default_factory=dict)
    settings: Tables = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)
    keep: str = "wrong"

    def address(self, revision: str) -> str:
        """Name of its result: the same for the same content and code, another one for any other."""
        content = {key: value for key, value in asdict(self).items() if key not in ("log", "keep")}
        if self.log:
            content["log"] = Path(self.log).name
        text = json.dumps([revision, content], sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:20]

    @property
    def what(self) -> str:
        """For people: what flies."""
        return self.mission.rsplit("/", 1)[-1] or Path(self.log).name or self.call

    @property
    def text(self) -> str:
        """For people: the whole flight on a line."""
        point = [
            f"{name} {value if isinstance(value, str) else format(value, '.6g')}" for name, value in self.point.items()
        ]
        return ", ".join([f"{self.what} seed {self.seed}" if not self.log else self.what, *point, *self.faults])

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


def items(plan: CampaignPlan) -> list[Item]:
    """Every flight of a plan, in order.

    Raises:
        ConfigError: a file that the plan names cannot be used, or it comes to no flight.
    """
    found = list(_items(plan))
    if not found:
        raise config.ConfigError(f"{plan.path}: there is no log below {plan.file.flight.logs}; name another folder")
    return found


def _items(plan: CampaignPlan) -> Iterator[Item]:
    file = plan.file
    seeds = range(file.campaign.first_seed, file.campaign.first_seed + file.campaign.seeds)
    begun = _Begun(plan)
    if file.flight.logs is not None:
        logs = flights(sorted(plan.beside(file.flight.logs).rglob("*.mcap")))
        for segments, levels in itertools.product(logs, list(_grid(file.factor))):
            yield begun.item(0, levels, segments)
    elif file.campaign.design == "grid":
        for levels, seed in itertools.product(list(_grid(file.factor)), seeds):
            yield begun.item(seed, levels)
    else:
        for seed in seeds:
            yield begun.item(seed, {name: _drawn(name, factor, seed) for name, factor in file.factor.items()})


def _grid(factors: dict[str, Factor]) -> Iterator[dict[str, Any]]:
    """Every combination: a level's name or a value, by factor."""
    sides: list[list[Any]] = [list(one.level) or list(one.values) or one.numbers() for one in factors.values()]
    for combination in itertools.product(*sides):
        yield dict(zip(factors, combination, strict=True))


def _drawn(name: str, factor: Factor, seed: int) -> Any:
    """A seed's level or value; each factor has a stream of its own: adding one leaves the others as they are."""
    rng = _rng(name, seed)
    if factor.level:
        weights = np.array([level.weight for level in factor.level.values()])
        return list(factor.level)[int(rng.choice(len(weights), p=weights / weights.sum()))]
    if factor.values:
        return factor.values[int(rng.integers(len(factor.values)))]
    return factor.between(float(rng.random()))


def _rng(name: str, seed: int) -> np.random.Generator:
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


class _Begun:
    """Makes items; reads each file that the plan names once."""

    def __init__(self, plan: CampaignPlan) -> None:
        self._plan = plan
        self._vehicles: dict[str, tuple[str, dict[str, str]]] = {}
        self._over, self._over_files = self._scenario_file()
        self._checked: set[str] = set()
        self._digests: dict[Path, str] = {}
        called = plan.file.flight.vehicle
        self._vehicle_of_logs = self._laid_out(called) if called else ("", {})

    def item(self, seed: int, levels: dict[str, Any], log: Sequence[Path] = ()) -> Item:
        """A flight at a point of the design."""
        file = self._plan.file
        tables = {"scenario": config.laid_over(self._over, file.scenario)}
        tables |= {"vehicle": file.vehicle, "settings": file.settings}
        mission, faults = file.flight.mission or "", list(file.flight.faults)
        for name, chosen in levels.items():
            factor = file.factor[name]
            if factor.key is not None:
                set_, *inside = factor.key.split(".")
                tables[set_] = config.laid_over(tables[set_], _nested(inside, chosen))
                continue
            level = factor.level[chosen]
            tables = {key: config.laid_over(table, getattr(level, key)) for key, table in tables.items()}
            mission, faults = level.mission or mission, [*faults, *level.faults]
        if file.faults is not None:
            faults += _drawn_faults(file.faults, mission, seed, self._plan)
        name, files = self._laid_out(mission) if mission else self._vehicle_of_logs
        files = files | self._over_files
        if tables["vehicle"]:
            self._check_vehicle(name, files, tables["vehicle"])
        return Item(
            seed,
            {name: _shown(value) for name, value in levels.items()},
            name,
            str(log[0].absolute()) if log else "",
            " ".join(map(self._digest, log)),
            file.flight.call or "",
            tuple(faults),
            **tables,
            files=files,
            keep=file.campaign.keep,
        )

    def _laid_out(self, name: str) -> tuple[str, dict[str, str]]:
        """What a worker calls a vehicle, and the files that it needs for it."""
        if name not in self._vehicles:
            if not name.endswith(".toml"):
                config.named(name)  # refuses one that is not packaged
                self._vehicles[name] = name, {}
            else:
                vehicle = config.load(self._plan.beside(name))
                urdf = vehicle.file.vehicle.urdf
                place = os.path.normpath(f"{_DEPTH}/{urdf}")
                if Path(urdf).is_absolute() or place.startswith(".."):
                    raise config.ConfigError(f"{vehicle.path}: its URDF {urdf} lies far away; put it beside the file")
                texts = {place: config.read(vehicle.urdf_path, "a URDF", MOST_BYTES_URDF)}
                said = f"{_DEPTH}/{Path(name).name}"
                self._vehicles[name] = said, texts | {said: config.read(vehicle.path)}
        return self._vehicles[name]

    def _scenario_file(self) -> tuple[Tables, dict[str, str]]:
        """Tables of the plan's scenario file, and the motion that it names."""
        over = self._plan.file.flight.over
        if over is None:
            return {}, {}
        path = self._plan.beside(over)
        tables = config.tree_of(config.read(path, "a scenario file"), str(path))
        motion = tables.get("motion")
        if isinstance(motion, dict) and isinstance(motion.get("csv"), str):
            text = config.read(path.parent / motion["csv"], "a CSV of motion", MOST_BYTES_URDF)
            return config.laid_over(tables, {"motion": {"csv": "motion.csv"}}), {"motion.csv": text}
        return tables, {}

    def _check_vehicle(self, name: str, files: dict[str, str], tables: Tables) -> None:
        """Settings that do not fit are refused before anything flies."""
        key = json.dumps([name, tables], sort_keys=True, default=str)
        if key in self._checked or not name:
            return
        text = files[name] if name in files else config.read(config.packaged(name))
        path = self._plan.path if name in files else config.packaged(name)
        tree = config.laid_over(config.tree_of(text, name), tables)
        config.parse_tree(tree, path, config.Origin(f"{self._plan.path}: vehicle"))
        self._checked.add(key)

    def _digest(self, log: Path) -> str:
        if log not in self._digests:
            made = hashlib.sha256()
            with log.open("rb") as file:
                while chunk := file.read(_CHUNK):
                    made.update(chunk)
            self._digests[log] = made.hexdigest()
        return self._digests[log]


def _nested(keys: list[str], value: Any) -> Tables:
    for key in reversed(keys):
        value = {key: value}
    return dict(value)


def _shown(value: Any) -> str | float:
    """A level's name, or a number, as a column of the results has it."""
    if isinstance(value, str):
        return value
    return json.dumps(value) if isinstance(value, bool | list | tuple) else float(value)


def _drawn_faults(wanted: RandomFaults, mission: str, seed: int, plan: CampaignPlan) -> Iterator[str]:
    """A seed's faults, as ``heft hil --fault`` has them."""
    if mission not in wanted.kinds:
        raise config.ConfigError(
            f"{plan.path}: [faults] kinds has no {mission}, which this plan flies; add its devices"
        )
    rng = _rng("faults", seed)
    kinds = wanted.kinds[mission]
    share = np.array(wanted.count)
    count = int(rng.choice(len(share), p=share / share.sum()))
    for device in rng.permutation(list(kinds))[:count].tolist():
        kind, _, value = str(rng.choice(list(kinds[device]))).partition(":")
        start_s = float(rng.uniform(*wanted.start_s))
        length_s, stays = float(rng.uniform(*wanted.length_s)), rng.random() < wanted.staying
        end = "" if stays else f"{start_s + length_s:.3f}"
        yield f"{kind}:{device}:{start_s:.3f}:{end}" + (f":{value}" if value else "")
