"""A weighing as tables, as JSON and as a figure."""

from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Column, Table
from rich.text import Text

from onboard.estimation.policy import HALF
from onboard.ground.calibrate.result import digits
from onboard.ground.calibrate.weigh.further import Pose
from onboard.ground.calibrate.weigh.judge import Judged, alone
from onboard.ground.calibrate.weigh.weigh import Answer
from onboard.ground.drawing.theme import COLOUR, CYCLE, figures, subplots
from onboard.identification.quantities import QuantityEstimate

_SHOWN = {"kg": ("kg", 1.0), "m": ("mm", 1e3), "rad": ("deg", 180.0 / np.pi)}
_NAMES = {
    "m": "mass",
    "c_x": "centre of mass x",
    "c_y": "centre of mass y",
    "c_z": "centre of mass z",
    "installation_z": "sensor on its flange, about z",
    "installation_x": "sensor's tilt about its x",
    "installation_y": "sensor's tilt about its y",
    "base_tilt_1": "base's tilt, level axis 1",
    "base_tilt_2": "base's tilt, level axis 2",
}


def render(answer: Answer, judged: Judged, more: tuple[Pose, ...], title: str) -> RenderableType:
    """The answer in tables and sentences."""
    lines = [f"{judged.verdict.text}", *judged.notes]
    parts: list[RenderableType] = [_quantities(answer, judged, title), _axes(answer), *map(Text, lines)]
    if more:
        said = "; ".join(
            f"{one.text} (then mass +- {100.0 * HALF * one.mass_sigma_kg / abs(answer.quantities[0].value):.2g} %, "
            f"centre +- {1e3 * HALF * one.centre_sigma_m:.2g} mm)"
            for one in more
        )
        parts.append(Text(f"further poses that would tell most: {said}"))
    else:
        parts.append(Text("further poses would tell little: state the sensor's calibration better (--scale-percent)"))
    return Group(*parts)


def _quantities(answer: Answer, judged: Judged, title: str) -> Table:
    numbers = (Column(heading, justify="right") for heading in ("value", "from (95 %)", "to"))
    table = Table("", *numbers, "unit", "level", box=SIMPLE_HEAD, title=title, title_justify="left")
    for one in answer.quantities:
        unit, factor = _SHOWN[one.unit]
        level = judged.standings[one.name].level if one.name in judged.standings else ""
        if one.supported:
            places = digits(factor * one.sigma)
            shown = [f"{factor * value:.{places}f}" for value in (one.value, one.low, one.high)]
        else:
            shown, level = ["not known", "", ""], level or one.note
        table.add_row(_NAMES[one.name], *shown, unit, str(level))
    return table


def _axes(answer: Answer) -> Table:
    headings = ("mass by\nit, kg", "zero\nfitted", "zero at\nthe end", "1 sigma", "zero\nmoved", "noise")
    columns = (Column(heading, justify="right") for heading in headings)
    table = Table("", *columns, "unit", box=SIMPLE_HEAD, title="each axis", title_justify="left")
    for one in answer.axes:
        masses = [f"{one.alone_kg:.4g}", f"{one.mass_kg:.4g}"] if np.isfinite(one.alone_kg) else ["", ""]
        places = digits(one.zero_sigma)
        numbers = [f"{one.zero:.{places}f}", f"{one.zero_sigma:.2g}", f"{one.moved:+.2g}", f"{one.noise:.2g}"]
        table.add_row(one.name, *masses, *numbers, "N" if one.name.startswith("force") else "N m")
    return table


def as_json(answer: Answer, judged: Judged, more: tuple[Pose, ...]) -> dict[str, Any]:
    """For programs, SI units."""
    return {
        "verdict": {key: getattr(judged.verdict, key) for key in ("level", "reasons", "weak", "text")},
        "quantities": [_quantity(one, judged) for one in answer.quantities],
        "axes": [one._asdict() for one in answer.axes],
        "plain_least_squares": {"mass_kg": answer.plain[0], "sigma_kg": answer.plain[1], "axes": alone(answer)},
        "convention": answer.poses.convention._asdict(),
        "others": [{**other._asdict(), "nats": nats} for other, nats in answer.others],
        "rows": dict(answer.count),
        "outliers": [row + 1 for row in answer.outliers],
        "held_out": answer.held_out,
        "scale_spread": (answer.known.scale * answer.weighing.spread).tolist(),
        "cross_talk": answer.weighing.best.noise.cross,
        "further_poses": [{**one._asdict(), "text": one.text} for one in more],
        "notes": judged.notes,
    }


def _quantity(one: QuantityEstimate, judged: Judged) -> dict[str, Any]:
    own = judged.standings.get(one.name)
    kept = ("value", "name", "unit", "sigma", "low", "high", "supported", "leans")
    level = {"level": own.level, "why": own.why} if own else {}
    return {**{key: getattr(one, key) for key in kept}, **level}


def draw(answer: Answer, path: Path) -> None:
    """Mass by axis, zeros, what is left over, and where gravity pointed; the format by the suffix.

    Raises:
        ValueError: a format that Matplotlib does not write.
    """
    mass = answer.quantities[0]
    pose = np.arange(len(answer.zeros)) + 1
    with figures():
        figure, (masses, ball, forces, moments) = subplots(2, 2, 2.4, 1.4)
        _draw_masses(masses, answer, mass)
        down = np.einsum("nba,b->na", answer.poses.R, answer.known.prior.gravity_m_s2) @ (
            answer.weighing.best.state.mounting.T
        )
        down /= np.linalg.norm(down, axis=1, keepdims=True)
        ball.scatter(np.rad2deg(np.arctan2(down[:, 1], down[:, 0])), np.rad2deg(np.arcsin(down[:, 2])), s=9)
        ball.set_xlim(-185, 185)
        ball.set_ylim(-95, 95)
        ball.set_title("gravity in sensor axes: azimuth, elevation, deg")
        for axes, first, unit in ((forces, 0, "N"), (moments, 3, "N m")):
            for k in range(first, first + 3):
                of = answer.zeros[:, k]
                axes.plot(pose, of - of[0], color=CYCLE[k - first], label="xyz"[k - first])
                left = answer.weighing.best.residual[:, k]
                axes.plot(pose, left - of[0], ".", ms=2.5, color=CYCLE[k - first])
            axes.set_title(f"zeros since the first pose, {unit}; dots: by pose")
            axes.set_xlabel("pose")
            axes.legend(loc="best", ncols=3)
        figure.savefig(path, facecolor="white", dpi=130)


def _draw_masses(axes: Any, answer: Answer, mass: QuantityEstimate) -> None:
    if mass.supported:
        axes.axvspan(mass.low, mass.high, color=COLOUR["good"], alpha=0.18, lw=0)
        axes.axvline(mass.value, color=COLOUR["good"])
    rows = [(f"{one.name[-1]} alone", one.alone_kg, one.alone_sigma_kg) for one in answer.axes[:3]]
    rows += [(f"{one.name[-1]}, zero fitted", one.mass_kg, one.mass_sigma_kg) for one in answer.axes[:3]]
    rows += [("plain least squares", *answer.plain)]
    for k, (_, value, sigma) in enumerate(rows):
        axes.errorbar(value, k, xerr=HALF * sigma, fmt="o", ms=4, color=CYCLE[k // 3], capsize=3)
    axes.set_yticks(range(len(rows)), [name for name, *_ in rows])
    axes.invert_yaxis()
    axes.set_title("mass, kg, by axis; band: the answer")
