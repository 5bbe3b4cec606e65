"""Terminal output of ``heft identify``, 80 columns."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import body_jacobian
from onboard.estimation.policy import HALF
from onboard.ground.calibrate.result import digits
from onboard.ground.identify import runs_view
from onboard.ground.identify.identify import Identification
from onboard.ground.identify.kinds.identified import Identified
from onboard.ground.identify.kinds.throws import LoadSummary
from onboard.identification.rows.free_body import PrincipalMoments
from onboard.identification.rows.standard import LinkEstimate
from onboard.identification.standing import Level
from onboard.identification.verdict import Verdict

_BAR, _LEAST_SHARE = 20, 0.01
_NO_BUDGET = (
    "no budget: it is made by rows, of supported [estimation.quantities] and of a payload whose ten parameters are all "
    "determined, and of bodies without joints; see what each answer leans on"
)
PER_KG_MM2 = 1e6
_STYLE = {Level.GOOD: "bold green", Level.WEAK: "bold yellow", Level.DO_NOT_USE: "bold red"}


def render(found: Identification) -> RenderableType:
    """The result as tables."""
    told = [Text(f"by the recording: {one}") for one in found.recorded]
    if not any(log.throw for log in found.logs):
        for path, one in found.predicted:
            told.append(Text(f"{path} predicted from {found.logs[0].log} to {100 * one.relative_error:.2f} %"))
        return Group(*(part for log in found.logs for part in _one(log)), *told)
    parts: list[RenderableType] = []
    for name in dict.fromkeys(log.throw.load.name for log in found.logs if log.throw):
        mine = [log for log in found.logs if log.throw and log.throw.load.name == name]
        parts.append(_throws(mine, found.together[name].principal))
    if found.summaries:
        parts.append(_summary(found.summaries))
    judged = [log for log in found.logs if log.verdict.level is not Level.GOOD]
    parts += [Text.assemble(f"{log.log.stem}: ", _verdict(log.verdict)) for log in judged]
    if found.calibration:
        rotor = found.calibration.rotor
        text = (
            f"calibration from the throws above: the rotor's inertia in {found.vehicle.file.vehicle.urdf} times "
            f"{rotor.factor:.4f} ± {rotor.sigma:.4f} (sigma), misfit {100 * rotor.misfit:.2f} %; for the vehicle file:"
        )
        parts += [Text(text), Text(f"\n{found.calibration.as_toml()}\n")]
    return Group(*parts, *told)


def budgets(found: Identification) -> RenderableType:
    """What each answer's interval is made of, the largest part first, with a bar of its share of the variance."""
    parts: list[RenderableType] = []
    for log in found.logs:
        width = {one.name: one.high - one.value for one in log.answers if one.supported}
        for name in (name for name in log.budget if name in width):
            unit = next(one.unit for one in log.answers if one.name == name)
            table = runs_view.of_numbers(f"{name} +- {width[name]:.3g} {unit} (95 %)", "share", "sigma", "of")
            for one in log.budget[name]:
                if one.share >= _LEAST_SHARE:
                    share = f"{one.share:4.0%} {'#' * max(1, round(_BAR * one.share)):{_BAR}s}"
                    table.add_row(share, f"{one.sigma:.2g}", Text(one.cause, justify="left"))
            parts.append(table)
    return Group(*parts) if parts else Text(_NO_BUDGET)


def _verdict(verdict: Verdict) -> Text:
    said = Text(verdict.text)
    said.stylize(_STYLE[verdict.level], 0, len(verdict.level))
    return said


def _one(log: Identified) -> list[RenderableType]:
    """Estimates of a log, and below them the evidence."""
    answers = runs_view.of_numbers("", "", "unit", "value", "95 % interval", "bound", "level")
    for answer in log.answers:
        if answer.supported:
            interval = f"{answer.low:.4g} .. {answer.high:.4g}"
            numbers = f"{answer.value:.4g}", interval, f"{answer.bound:.1g}"
            answers.add_row(answer.name, answer.unit, *numbers, log.standing(answer).level)
    notes = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    notes.add_column(no_wrap=True)
    notes.add_column(overflow="fold")
    notes.add_row("verdict", _verdict(log.verdict))
    notes.add_row("method", log.method)
    if any(answer.supported for answer in log.answers):
        notes.add_row("bound", "smallest sigma possible with this motion (Cramér-Rao)")
    for name, text in _notes(log):
        notes.add_row(name, text)
    head = Text(str(log.log), style="bold")
    told = runs_view.render([run.as_json() for run in log.runs])
    return [head, *([answers] if answers.rows else []), notes, *told, Text()]


def _notes(log: Identified) -> Iterator[tuple[str, str]]:
    for answer in (one for one in log.answers if one.leans and one.unit == "kg"):
        yield answer.name, answer.leans
    if unknown := [answer.name for answer in log.answers if not answer.supported]:
        yield "undetermined", ", ".join(unknown)
    told = [answer.name for answer in log.answers if answer.supported and not answer.unit]
    if nothing := [name for name in told if name not in log.essential]:
        yield "no different", f"from zero: {', '.join(nothing)}; essential: {', '.join(log.essential)}"
    if log.held_out is not None:
        later, earlier, fit = (f"{100 * one.relative_error:.1f} %" for one in log.held_out)
        yield "held out", f"later half predicted from the earlier to {later}, earlier from the later to {earlier}"
        yield "", f"left over by the fit of all: {fit}"
    if log.left_over and log.band_Hz is not None:
        each = (f"{name} {one.rms:.2g} of {one.of_rms:.2g}" for name, one in log.left_over.items())
        yield "unweighted", f"rms below {log.band_Hz:.2g} Hz, in the unit of each: {', '.join(each)}"
    if log.misfit is not None:
        yield "misfit", f"{log.misfit:.2f} of the noise"
    if log.observability is not None:
        seen = log.observability
        condition = f", condition number {seen.condition:.0f}" if seen.determined else ""
        yield "observable", f"{seen.determined} of {seen.of} directions{condition}"
    if log.before is not None:
        half = HALF * log.before.sigma
        yield "before capture", f"turned at {within_interval(log.before.rate_rad_s, half[3:])} rad/s in space, and"
        velocity = within_interval(1e3 * log.before.velocity_m_s, 1e3 * half[:3])
        yield "", f"came at {velocity} mm/s to the gripper, in its axes"
    yield from ((one.link, _body(one, one.body)) for one in log.links if one.body is not None)
    if log.refused.get("stuck"):
        said = "readings repeat where they must change; where a recorder writes them more than once, say repeats = true"
        yield "stuck", f"{said} in the [device] of its channel"
    left_out = ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in log.refused.items())
    yield "rows", f"{log.rows_used} used; left out: {left_out or 'none'}"


def _body(link: LinkEstimate, body: RigidBody) -> str:
    J = body_jacobian(link.mean)[:4]
    half = HALF * np.sqrt(np.einsum("ri,ij,rj->r", J, link.covariance, J))
    mass = within_interval(np.array([body.mass_kg]), half[:1])
    said = f"{mass} kg, centre of mass {within_interval(1e3 * body.centre_of_mass_m, 1e3 * half[1:])} mm"
    if body.mass_kg <= half[0]:
        said += "; the rows do not tell its mass apart from where it is: a cell for a force does, or six axes"
    if away := round(link.away, 1):
        said += f"; for the URDF: nearest to the table of bodies that can exist, {away:.1f} sigmas off"
    return said


def within_interval(values: NDArray[np.float64], half: NDArray[np.float64]) -> str:
    """Values with the half widths of their intervals, to two digits of these."""
    places = (digits(wide) for wide in half)
    return ", ".join(f"{value:.{n}f} ± {wide:.{n}f}" for value, wide, n in zip(values, half, places, strict=True))


def _moments(principal: PrincipalMoments) -> list[str]:
    rows = zip(principal.moments, principal.high, strict=True)
    return [f"{PER_KG_MM2 * value:.1f} ± {PER_KG_MM2 * (high - value):.1f}" for value, high in rows]


def _throws(logs: Sequence[Identified], together: PrincipalMoments | None) -> Table:
    """One load's throws, and all of them in one estimate."""
    stems = [log.log.stem for log in logs]
    heads = {stem[: stem.rfind("_") + 1] for stem in stems}  # common prefix, already in the title
    shared = len(heads.pop()) if len(heads) == 1 else 0
    load = next(log.throw.load for log in logs if log.throw)
    title = f"{load.name}, {1e3 * load.mass_kg:g} g: principal moments ± 95 %, kg mm²"
    table = runs_view.of_numbers(title, "", "I1", "I2", "I3", "err %", "held out %")
    for log, stem in zip(logs, stems, strict=True):
        principal = log.throw.principal if log.throw else None
        if log.throw is None or principal is None:
            table.add_row(stem[shared:], "—", "not determined", "—")
            continue
        error = "" if log.throw.error_percent is None else f"{log.throw.error_percent:.2f}"
        held_out = "" if log.held_out is None else f"{100 * log.held_out.worst.relative_error:.1f}"
        table.add_row(stem[shared:], *_moments(principal), error, held_out)
    if together is not None and len(logs) > 1:
        table.add_section()
        table.add_row("all together", *_moments(together), "", "")
    if load.truth_kg_m2:
        table.add_section()
        table.add_row("truth", *(f"{PER_KG_MM2 * value:.1f}" for value in sorted(load.truth_kg_m2)))
    return table


def _summary(summaries: Sequence[LoadSummary]) -> Table:
    title = "error of the principal moments, norm over norm of the truth"
    table = runs_view.of_numbers(title, "", "throws", "mean %", "bar", "worst %", "bar", "in interval")
    for one in summaries:
        mean_bar, worst_bar = (f"{bar:g}" for bar in one.load.bars_percent) if one.load.bars_percent else ("", "")
        throws_said = f"{one.throws}" if one.answered == one.throws else f"{one.answered} of {one.throws}"
        mean, worst = f"{one.mean_percent:.2f}", f"{one.worst_percent:.2f}"
        table.add_row(one.load.name, throws_said, mean, mean_bar, worst, worst_bar, f"{one.covered_percent:.0f} %")
    return table
