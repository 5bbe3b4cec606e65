"""Level and reasons of a weighing, by the rules of all estimates (:mod:`onboard.identification.verdict`)."""

import math
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.inertia import sphere_radius_m
from onboard.estimation.policy import FARTHEST_SIZE, LIKELIER, MOSTLY, times_text
from onboard.ground.calibrate.weigh.units import likelier
from onboard.ground.calibrate.weigh.weigh import Answer
from onboard.identification.corrections import doubtful_from
from onboard.identification.quantities import Findings, Size, Useful
from onboard.identification.standing import Level, Standing, standing
from onboard.identification.verdict import Evidence, Verdict, standings_of, verdict

FARTHEST_m = 2.0
"""Centre of mass beyond which a unit is wrong: no wrist that a person handles holds a tool so; moments of a held tool
in N mm that are taken for N m are a thousand times too large."""
HEAVIEST_kg = 2300.0
"""Mass beyond which a unit is wrong: the largest payload of an arm that is sold (Fanuc M-2000iA/2300)."""
_SEATED_rad = np.deg2rad(3.0)  # a sensor on its flange: by bolts and a pin


class Judged(NamedTuple):
    """What is said of an answer."""

    verdict: Verdict
    standings: dict[str, Standing]
    notes: tuple[str, ...]


def judge(answer: Answer) -> Judged:
    """Level of each quantity and of the whole."""
    findings = _findings(answer)
    body = answer.quantities[:4]
    mass, centre = body[0].value, np.array([one.value for one in body[1:]])
    # root mean square distance of a sphere's mass
    size = float(np.sqrt(centre @ centre + 0.6 * sphere_radius_m(mass) ** 2))
    useful = Useful()
    sizes = {"m": Size(mass, useful.mass, "it")} | {
        one.name: Size(size, useful.centre, "the body's size") for one in body[1:]
    }
    odd = _odd(answer)
    spread = np.maximum(answer.weighing.spread, 1.0)
    named = zip(answer.axes, spread, strict=True)
    corrections = {f"the scale of {one.name}": one.scale / wide for k, (one, wide) in enumerate(named) if k not in odd}
    units = _unnamed(answer)
    of_mass = units if "force" in answer.unnamed else Findings()
    own = {one.name: standing(one, of_mass if one is body[0] else units, sizes.get(one.name)) for one in body}
    evidence = Evidence(
        answer.count["poses"] - len(answer.outliers),
        {},  # outliers weaken an answer: of some dozen poses one or two are soon a twentieth
        {one.name: one.supported for one in body},
        answer.held_out,
        findings=findings,
        standings=own,
        corrections=corrections,
        unchecked="too few poses to predict a half from the other: twelve or more",
    )
    return Judged(verdict(evidence), standings_of(evidence), tuple(_notes(answer)))


def judge_live(answer: Answer, frame: str) -> Judged:
    """The same of a sensor that a vehicle file describes: its sign and its mounting are held against the file."""
    judged = judge(answer)
    said, notes = [], list(judged.notes)
    if answer.poses.convention.sign == "weight":
        said.append(
            f"the cells of {frame} read the weight, and a vehicle file's cells read what holds it: turn the sign of "
            "each `axis`"
        )
    turned = [one for one in answer.quantities if one.name.startswith("installation")]
    off = [one for one in turned if one.supported and not -_SEATED_rad < one.value < _SEATED_rad]
    if off:
        told = ", ".join(f"{np.rad2deg(one.value):.1f} deg about its {one.name[-1]}" for one in off)
        notes.append(
            f"the sensor sits turned against {frame} as it is drawn, by {told}: correct the URDF or each `axis`"
        )
    if said:
        level, reasons = Level.DO_NOT_USE, (*said, *judged.verdict.reasons)
        each = {name: one.after(Findings(tuple(said))) for name, one in judged.standings.items()}
        judged = judged._replace(verdict=judged.verdict._replace(level=level, reasons=reasons), standings=each)
    return judged._replace(notes=tuple(notes))


def _findings(answer: Answer) -> Findings:
    against, doubts = [], []
    against += [
        f"{axis.name} reads the same in poses that differ: it is stuck or at the end of its range, or another column "
        "is meant"
        for axis in answer.axes
        if axis.frozen
    ]
    if answer.changed is not None and not against:
        row, body = answer.changed
        against.append(
            f"from row {row + 1} on another body is held, of {body.after_kg:.4g} kg after {body.before_kg:.4g} kg, "
            f"{times_text(body.nats)} times likelier than a single body: weigh each part of the table by itself"
        )
    if answer.wrong is not None and not against:
        against.append(f"{answer.wrong.what}: so the readings agree, {times_text(answer.wrong.nats)} times likelier")
    mass = answer.quantities[0]
    far = _far_m(answer)
    if mass.supported and far > FARTHEST_m:
        against.append(
            f"the centre of mass would be {far:.3g} m from the sensor: its moments are in another unit than N m"
            f"{_others(answer) or ' (--moment-unit Nmm, mNm ...)'}"
        )
    left = answer.left_over.relative_error
    if left**2 > MOSTLY and not against:
        against.append(
            f"no body explains the readings: {left:.0%} of what they change by from pose to pose is left over; rows of "
            "poses and of wrenches that do not belong together (shifted, sorted), another kind of orientation "
            "(--orientation), joints (--urdf) of another order, sign or zero, or noise larger than the weight"
        )
    if mass.supported and mass.value > HEAVIEST_kg:
        against.append(
            f"{mass.value:.3g} kg is more than any arm holds: its forces are in another unit than N, or are counts "
            "(--force-unit and --moment-unit: a name, or its size in N and N m, 1e-6 for instance)"
        )
    if answer.said_down and (lean := _lean(answer)):
        doubts.append(f"{lean}: say how far it may lean (--tilt-deg)")
    if answer.outliers:
        doubts.append(f"{len(answer.outliers)} of {answer.count['poses']} poses contradict the others: left out")
    if odd := _odd(answer):
        axis, *others = (answer.axes[k] for k in odd)
        which = "".join([axis.name, *(f" or of {one.name}" for one in others)])
        size = "" if others else f" by {axis.scale * answer.known.scale:+.1%}, as the other axes agree,"
        doubts.append(
            f"the scale of {which} is off{size} and is stated to {100.0 * answer.known.scale:.2g} %: taken for "
            "unknown; calibrate the sensor"
        )
    if mass.supported and answer.weighing.wider(FARTHEST_SIZE)[0] > LIKELIER:
        stated, taken = 100.0 * answer.known.scale * np.array([1.0, answer.weighing.spread.mean()])
        doubts.append(
            f"the axes contradict each other: {fitted(answer)}, where scales are stated to {stated:.2g} %, and taken "
            f"as known to {taken:.2g} (--scale-percent): hang a known mass on it, or calibrate the sensor"
        )
    plain, _ = answer.plain
    if not odd and mass.supported and not mass.low <= plain <= mass.high:
        k = int(np.abs([one.moved / one.noise for one in answer.axes[:3]]).argmax())
        axis = answer.axes[k]
        weight = abs(mass.value) * answer.known.place.gravity_m_s2
        moved = float(np.ptp(answer.zeros[:, k]))
        said = f"{alone(answer)}: the axes contradict each other while their zeros are taken for constant"
        if moved > 0.0:
            said += f"; the zero of {axis.name} moved by {moved:.2g} N ({moved / weight:.0%} of the weight)"
        doubts.append(f"{said}; plain least squares would say {plain:.4g} kg")
    return Findings(tuple(against), tuple(doubts))


def _unnamed(answer: Answer) -> Findings:
    """That nobody named a unit: what the mass, or the centre alone, is by assumption."""
    if not answer.unnamed:
        return Findings()
    taken = " and ".join(f"{what}s as {'N' if what == 'force' else 'N m'}" for what in answer.unnamed)
    options = " ".join(f"--{what}-unit {'N' if what == 'force' else 'Nm'}" for what in answer.unnamed)
    others = "" if _far_m(answer) > FARTHEST_m else _others(answer)  # else they are said with the refusal
    return Findings((), (f"no unit is named: {taken} ({options} says so){others}",))


def _far_m(answer: Answer) -> float:
    """Centre of mass from the sensor."""
    return float(np.linalg.norm([one.value for one in answer.quantities[1:4]]))


def _others(answer: Answer) -> str:
    """Units that are likelier than those taken; empty where none are, or where they are named."""
    said = likelier(answer.quantities[0].value, _far_m(answer), answer.unnamed) if answer.unnamed else ""
    return f"; it would be {said}" if said else ""


def _odd(answer: Answer) -> list[int]:
    """The axis whose scale alone is not as stated, or the likeliest of which one is; none where that is unlikely."""
    alone = answer.weighing.wider(FARTHEST_SIZE)[1]
    if alone.sum() <= LIKELIER:
        return []
    order = np.argsort(-alone)
    likeliest: list[int] = order[: int(np.searchsorted(np.cumsum(alone[order]), LIKELIER)) + 1].tolist()
    return likeliest


def _lean(answer: Answer) -> str:
    """That the base leans by more than chance makes of its stated sigma; empty where it does not."""
    tilts, stated = [one.value for one in answer.quantities[-2:]], answer.known.tilt_rad
    if max(map(abs, tilts)) <= stated * doubtful_from(len(tilts)):
        return ""
    return (
        f"the base leans by {np.rad2deg(math.hypot(*tilts)):.0f} deg against --gravity="
        f"{answer.poses.convention.gravity}, which is stated to {np.rad2deg(stated):.2g}"
    )


def alone(answer: Answer) -> str:
    """``x, y, z alone give 1.189, 1.165, 1.254 kg``."""
    return f"x, y, z alone give {', '.join(f'{one.alone_kg:.4g}' for one in answer.axes[:3])} kg"


def fitted(answer: Answer) -> str:
    """``by axis, zeros fitted, x, y, z say 1.168, 1.164, 1.19 kg``."""
    return f"by axis, zeros fitted, x, y, z say {', '.join(f'{one.mass_kg:.4g}' for one in answer.axes[:3])} kg"


def _notes(answer: Answer) -> list[str]:
    count = answer.count
    said = [f"{count['poses']} poses of {count['rows']} rows: {answer.poses.convention.text}"]
    if len(answer.others) > 1:
        second = max((one for one in answer.others if one[0] != answer.poses.convention), key=lambda one: one[1])
        less = times_text(-second[1])
        said.append(f"the next likeliest of {len(answer.others)}, {less} times less likely: {second[0].text}")
    if not answer.said_down and (lean := _lean(answer)):
        said.append(f"{lean}, as the readings agree; nobody said how it stands")
    for kind, why in (("bad", "a cell that is no number, or no orientation"), ("moving", "taken between poses")):
        if count[kind]:
            said.append(f"{count[kind]} rows left out: {why}")
    if answer.outliers:
        said.append(f"left out as outliers: rows {', '.join(str(row + 1) for row in answer.outliers[:10])}")
    if answer.quantities[0].supported:
        said.append(fitted(answer))
    if answer.quantities[3].supported and answer.quantities[3].high < 0.0:
        said.append("the centre of mass is on the side of the sensor's -z: if the tool is not, all moments are turned")
    if answer.quantities[0].leans:
        said.append(f"the mass {answer.quantities[0].leans}: what the scales of all axes share, no pose shows")
    return said
