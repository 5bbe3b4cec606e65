"""A campaign's directory: one Parquet data set of results, failures, kept logs, and what the campaign consists of.

``flights/ADDRESS.parquet`` is a flight's rows, one a quantity; pyarrow, pandas, DuckDB and Polars read the folder as
one table, also while the campaign runs: a file takes its name when it is whole and on the medium.
``failed/ADDRESS.json`` is a failure with its traceback, ``logs/ADDRESS.mcap`` a log that stays, and ``campaign.json``
lists the addresses of all flights in order. An address is a hash of the flight and of the code: results of another plan
or version stay beside, and do not count.
"""

import json
import math
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from onboard.channels import NUMBERS
from onboard.ground.campaign.design import Item
from onboard.ground.campaign.results import FlightAnswer, FlightResult, Returned

FACTOR = "factor "  # begins the name of a factor's column
_COLUMNS: dict[str, Any] = {
    **{"flight": pa.string(), "revision": pa.string(), "what": pa.string(), "seed": pa.int64(), "log": pa.string()},
    **{"faults": pa.list_(pa.string()), "quantity": pa.string(), "unit": pa.string()},
    **dict.fromkeys(("truth", *NUMBERS, "bound", "drawn"), pa.float64()),
    **{"supported": pa.bool_(), "level": pa.string(), "why": pa.string(), "leans": pa.string()},
    **{"outcome": pa.string(), "unseen": pa.bool_(), "accounted": pa.bool_(), "capture_s": pa.float64()},
    **{"detected_s": pa.float64(), "detections": pa.int64(), "events": pa.list_(pa.string())},
    **{"instants": pa.int64(), "instants_beyond": pa.int64(), "instants_good_beyond": pa.int64()},
    "instants_farthest": pa.float64(),
}


class Content(NamedTuple):
    """What ``campaign.json`` says."""

    name: str
    plan: str  # text
    revision: str
    items: dict[str, Item]  # by address, in order


class Store:
    """A campaign's directory.

    Args:
        directory: of the campaign; made when something is written.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.flights, self.failed, self.logs = (directory / name for name in ("flights", "failed", "logs"))

    def begin(self, content: Content) -> None:
        """Write what the campaign consists of. A flight that was cut short in writing is taken away."""
        for folder in (self.flights, self.failed, self.logs):
            folder.mkdir(parents=True, exist_ok=True)
            for rest in folder.glob(".*.part"):
                rest.unlink()
        told = {**content._asdict(), "items": {key: item.as_json() for key, item in content.items.items()}}
        _write(self.directory / "campaign.json", (json.dumps(told) + "\n").encode())

    def content(self) -> Content:
        """What the campaign consists of.

        Raises:
            ValueError: the directory is not a campaign's.
        """
        path = self.directory / "campaign.json"
        try:
            told = json.loads(path.read_text(encoding="utf-8"))
            items = {key: Item(**item | {"faults": tuple(item["faults"])}) for key, item in told.pop("items").items()}
            return Content(**told, items=items)
        except (OSError, KeyError, TypeError, AttributeError, ValueError) as error:
            said = f"{self.directory} is not the directory of a campaign ({type(error).__name__}: {error})"
            raise ValueError(f"{said}; give the directory that heft campaign wrote into") from error

    def is_done(self, address: str) -> bool:
        """Whether there is a result."""
        return self._part(address).exists()

    def has_failed(self, address: str) -> bool:
        """Whether there is a failure."""
        return self._failure(address).exists()

    def take(self, address: str, item: Item, revision: str, done: Returned) -> None:
        """Keep what a flight gave, if it is not there already."""
        if self.is_done(address):
            return
        for end, data in done.kept.items():
            _write(self.logs / f"{address}{end}", data)
        if done.result is None:
            told = {"flight": address, "what": item.text, "error": done.error, "item": item.as_json()}
            _write(self._failure(address), (json.dumps(told, indent=1) + "\n").encode())
            return
        buffer = pa.BufferOutputStream()
        pq.write_table(_table(address, item, revision, done.result), buffer, compression="zstd")
        _write(self._part(address), buffer.getvalue().to_pybytes())
        self._failure(address).unlink(missing_ok=True)

    def failures(self, addresses: Iterable[str]) -> dict[str, dict[str, Any]]:
        """What failed, by address."""
        return {
            address: json.loads(self._failure(address).read_text(encoding="utf-8"))
            for address in addresses
            if self.has_failed(address) and not self.is_done(address)
        }

    def rows(self, addresses: Iterable[str]) -> list[dict[str, Any]]:
        """The rows of the flights that are done, in their order; null as None."""
        parts = [pq.read_table(self._part(address)) for address in addresses if self.is_done(address)]
        return [row for part in parts for row in part.to_pylist()]

    def log_of(self, address: str) -> Path | None:
        """The log that stays of a flight, if one does."""
        path = self.logs / f"{address}.mcap"
        return path if path.exists() else None

    def _part(self, address: str) -> Path:
        return self.flights / f"{address}.parquet"

    def _failure(self, address: str) -> Path:
        return self.failed / f"{address}.json"


def _write(path: Path, data: bytes) -> None:
    """A file that is whole or not there, whatever ends the program or the power."""
    part = path.with_name(f".{path.name}.part")
    with part.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


def _table(address: str, item: Item, revision: str, result: FlightResult) -> pa.Table:
    """A row a quantity; of a flight without answers one row with an empty quantity."""
    common: dict[str, Any] = {
        **{
            "flight": address,
            "revision": revision,
            "what": result.what or item.what,
            "seed": item.seed,
            "log": item.log,
        },
        **{"faults": [*item.faults, *result.faults], "unseen": result.unseen, "accounted": result.accounted},
        **{"capture_s": result.capture_s, "detected_s": result.detected_s, "detections": result.detections},
        "events": list(result.events),
    }
    columns = dict(_COLUMNS)
    for name, value in item.point.items():
        columns[FACTOR + name] = pa.string() if isinstance(value, str) else pa.float64()
        common[FACTOR + name] = value
    rows = []
    for one in result.answers or (FlightAnswer(""),):
        outcome = str(one.outcome(unseen=result.unseen)) if one.quantity else ""
        told, beyond, good_beyond, farthest = one.instants
        outer = dict(zip(("low_999", "high_999"), one.outer, strict=True))
        seen = {"instants": told, "instants_beyond": beyond, "instants_good_beyond": good_beyond}
        rows.append(
            _plain({**common, **one._asdict(), **outer, "outcome": outcome, **seen, "instants_farthest": farthest})
        )
    return pa.Table.from_pylist(rows, schema=pa.schema(list(columns.items())))


def _plain(row: Mapping[str, Any]) -> dict[str, Any]:
    """NaN is null: a column's mean counts what is there."""
    return {key: None if isinstance(value, float) and math.isnan(value) else value for key, value in row.items()}
