"""Section of a report: each sweep identified by itself."""

from onboard.ground.drawing import html
from onboard.ground.drawing.gallery import Gallery
from onboard.ground.drawing.html import Cell
from onboard.ground.report.flight import answers
from onboard.ground.report.flight.alone import Alone, alone
from onboard.ground.report.flight.flight_data import FlightData

_ROWS_SHOWN = 24


def by_sweep(flight: FlightData, draw: Gallery, truths: dict[str, float]) -> str:
    """Figure and table of every sweep's estimate; empty without an estimator of rows."""
    if flight.identifier is None:
        return ""
    found = {sweep.phase.name: alone(sweep, flight.identifier) for sweep in flight.sweeps}
    body = draw(
        answers.by_sweep(flight, found, truths),
        "Each sweep identified by itself, from the prior and its rows alone, as it goes on, to compare with the other "
        "sweeps. Bands: 95 % by the rows alone, without the tolerances of the drawing: these are the same in every "
        "sweep, and are in the intervals of the answers. Dashed: truth.",
    )
    rows = [_alone_row(sweep, one, truths.get(one.name)) for sweep, every in found.items() for one in every]
    if not rows:
        return ""
    silent = [sweep for sweep, every in found.items() if not every]
    if len(rows) > _ROWS_SHOWN:
        rows = []  # shown in the figure
    more = html.paragraph(f"By themselves these determine nothing: {', '.join(silent)}.") if silent else ""
    headings = ["sweep", "quantity", "value", "95 % by the rows alone", "unit", "truth", "error %"]
    return body + html.table(headings, rows) + more


def _alone_row(sweep: str, one: Alone, truth: float | None) -> list[object]:
    value, low, high = float(one.value[-1]), float(one.low[-1]), float(one.high[-1])
    unit, factor = answers.shown_unit(one.unit, value)
    width = factor * (high - low)
    span = f"{answers.digits(factor * low, width)} … {answers.digits(factor * high, width)}"
    known = "" if truth is None else answers.digits(factor * truth, width)
    error = "" if not truth else f"{100 * (value / truth - 1):+.2f}"
    return [sweep, one.name, Cell(answers.digits(factor * value, width)), Cell(span), unit, Cell(known), Cell(error)]
