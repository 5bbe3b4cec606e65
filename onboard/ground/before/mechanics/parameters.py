"""``heft identify --parameters``: the base parameters of a vehicle's rows in symbols."""

from typing import Any, NamedTuple

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from onboard import config
from onboard.flight.estimate.problem.identification import NAMING_SEED, build_identifier
from onboard.flight.estimate.problem.model import build_model
from onboard.ground.before.mechanics.analysis import Counted, counted
from onboard.regressor.base_parameters import BaseParameters, base_parameters
from onboard.regressor.groupings import Groupings, groupings
from onboard.regressor.rows import RowModel, base_force_rows, base_moment_rows


class Parameters(NamedTuple):
    """Base parameters of a vehicle's rows."""

    vehicle: config.Vehicle
    rows: tuple[str, ...]
    standard: int  # how many standard parameters the rows have columns for
    base: BaseParameters
    written: Groupings
    counts: tuple[Counted, ...]

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        told = zip(self.base.names, self.written.names, self.written.sums, strict=True)
        return {
            "rows": list(self.rows),
            "standard_parameters": self.standard,
            "base_parameters": [{"name": name, "short": short, "grouping": text} for name, short, text in told],
            "lengths": [length._asdict() for length in self.written.lengths],
            "links": self.written.links,
            "counts": [
                {
                    "base": str(one.base),
                    "rows": one.rows,
                    "closed_form": None if one.closed_form is None else one.closed_form._asdict(),
                    "numerical": one.numerical,
                }
                for one in self.counts
            ],
        }


def parameters(vehicle: config.Vehicle) -> Parameters:
    """The base parameters of the rows that a vehicle's estimator has; of the zero wrench where it has none.

    Raises:
        ConfigError: the vehicle file does not fit its URDF.
        ModelError: a vehicle without any row.
    """
    if vehicle.file.estimation.predicts:  # it uses no rows; the zero wrench gives its identifiable parameters
        drawn = build_model(vehicle)
        model = RowModel(drawn, [*base_force_rows(drawn), *base_moment_rows(drawn)])
        base = base_parameters(model, np.random.default_rng(NAMING_SEED))
    else:
        identifier, _ = build_identifier(vehicle)  # first: it says which file is wrong
        drawn = build_model(vehicle)
        model, base = identifier.model, identifier.base
    rows = tuple(row.name for row in model.rows)
    counts = counted(vehicle.urdf_text, drawn)
    return Parameters(vehicle, rows, len(model.names), base, groupings(model, base), counts)


def render(found: Parameters) -> RenderableType:
    """The base parameters as text."""
    written, name = found.written, found.vehicle.file.vehicle.name
    links = ", ".join(f"{tag} {link}" if tag != link else link for tag, link in written.links.items())
    alone = ", ".join(name for name, text in zip(written.names, written.sums, strict=True) if name == text)
    sums = Table(box=None, pad_edge=False, show_header=False)
    for short, text in zip(written.names, written.sums, strict=True):
        if short != text:
            sums.add_row(Text(short, style="bold"), "=", text)
    lengths = Table(box=None, pad_edge=False, show_header=False)
    for length in written.lengths:
        lengths.add_row(Text(length.symbol, style="bold"), "=", f"{length.value_m:.4g} m", length.meaning)
    parts: list[RenderableType] = [
        Text(f"{name}: {len(written.names)} base parameters of {found.standard} standard ones"),
        Text(f"rows: {', '.join(found.rows)}\nlinks: {links}\n"),
        sums,
        Text(f"\nand by themselves: {alone}"),
    ]
    if written.lengths:
        parts += [Text(), lengths]
    if found.counts:
        parts += [Text(), _counts(found.counts)]
    return Group(*parts)


def _counts(counts: tuple[Counted, ...]) -> Table:
    title = "base parameters of this arm by kind of base, payload held"
    headings = ("base", "rows", "closed form", "numerical")
    table = Table(*headings, box=None, pad_edge=False, title=title, title_justify="left")
    for one in counts:
        closed = "-" if one.closed_form is None else f"{one.closed_form.parameters} = {one.closed_form.formula}"
        table.add_row(str(one.base), one.rows, closed, str(one.numerical))
    return table
