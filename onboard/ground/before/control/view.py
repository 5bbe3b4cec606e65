"""Table and figure of a :class:`onboard.ground.before.control.run.TrialSeries`."""

from pathlib import Path

import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.table import Column, Table
from rich.text import Text

from onboard.ground.before.control.run import COMPUTED, Trial, TrialSeries, TrialSetup
from onboard.ground.drawing.theme import CYCLE, figures, subplots

_GROWS = 1.005  # growth of the error per trial from which on it is reported
_SHORT = {TrialSetup.BEFORE: "payload unknown", TrialSetup.AFTER: "payload identified"}


def render(made: TrialSeries) -> RenderableType:
    """The trials as a table, and what is to be said of them."""
    wrong = f", model {100.0 * made.model_error:+.0f} %" if made.model_error else ""
    noisy = f", encoder noise {1e3 * made.noise_rad:g} mrad" if made.noise_rad else ""
    headings = ("joints rms, mrad", "largest, mrad", "tip rms, mm", "largest, mm")
    numbers = (Column(heading, justify="right", no_wrap=True) for heading in headings)
    title = f"{made.vehicle}: {made.controller}{wrong}{noisy}"
    columns = Column("trial", no_wrap=True), *numbers
    table = Table(*columns, title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for trial in made.trials:
        table.add_row(f"{trial.number} {trial.stage}", *_numbers(trial))
    lines = [_drives(made), *map(Text, findings_of(made))]
    if made.stopped:
        lines.append(Text(f"! stopped: {made.stopped}", style="yellow"))
    return Group(table, *lines)


def _numbers(trial: Trial) -> tuple[str, ...]:
    if not len(trial.flown.error):
        return ("—",) * 4
    largest = float(np.abs(trial.flown.error).max())
    values = trial.flown.rms_rad, largest, trial.tip_rms_m, float(trial.tip_m.max())
    return tuple(f"{1e3 * value:.3f}" for value in values)


def _drives(made: TrialSeries) -> Text:
    parts = zip(made.joints, *made.drives, strict=True)
    each = "; ".join(f"{name} {rotor:.3g}, {viscous:.3g}, {coulomb:.3g}" for name, rotor, viscous, coulomb in parts)
    return Text(f"drives, identified before the capture (kg m², N m s/rad, N m): {each}")


def findings_of(made: TrialSeries) -> list[str]:
    """What the trials say, in sentences."""
    lines = []
    if made.gain is not None:
        lines.append(
            f"tip error of the first trial with the identified payload: {made.gain:.1f} times smaller than without"
        )
    learned = made.of(TrialSetup.LEARNING)
    if made.rate is not None:
        lines.append(f"a trial left {made.rate:.2f} of the joints' error, until it no longer fell")
    if made.predicted is not None:
        slow = made.predicted[made.predicted[:, 1].argmax()]
        within = made.predicted[made.predicted[:, 0] <= 1.0, 1]
        known = "identified" if made.of(TrialSetup.AFTER) else "no"
        lines.append(f"by the model with {known} payload a trial leaves at most {within.max():.2f} up to 1 Hz")
        if slow[1] >= _GROWS:
            lines.append(f"! at {slow[0]:.1f} Hz the error would grow {slow[1]:.2f} times a trial")
    after = made.of(TrialSetup.AFTER)
    if learned and after:
        as_good = next((t.number for t in learned if t.tip_rms_m <= after[0].tip_rms_m), None)
        when = f"in trial {as_good}" if as_good is not None else f"not within {len(learned)} trials"
        lines.append(f"learning is as good as the first trial with the identified payload {when}")
    return lines


def draw(made: TrialSeries, path: Path) -> None:
    """Convergence as SVG or PNG by the ending: the tip's and the joints' rms error a trial."""
    with figures():
        drawn, (tip, joints) = subplots(1, 2, 3.0)
        stage = TrialSetup.AFTER if made.controller == COMPUTED else TrialSetup.LEARNING
        trials = made.of(stage)
        number = [trial.number for trial in trials]
        tip.semilogy(number, [1e3 * trial.tip_rms_m for trial in trials], "o-", label=made.controller, color=CYCLE[0])
        for other, color in ((TrialSetup.BEFORE, CYCLE[1]), (TrialSetup.AFTER, CYCLE[2])):
            if other is not stage and made.of(other):
                tip.axhline(1e3 * made.of(other)[0].tip_rms_m, color=color, label=f"computed torque, {_SHORT[other]}")
        each = np.array([np.sqrt((trial.flown.error**2).mean(axis=0)) for trial in trials if len(trial.flown.error)])
        for place, name in enumerate(made.joints):
            if len(each):
                joints.semilogy(
                    number[: len(each)], 1e3 * each[:, place], "o-", label=name, color=CYCLE[place % len(CYCLE)]
                )
        tip.set_title("tip, rms error, mm")
        joints.set_title("joints, rms error, mrad")
        for axes in (tip, joints):
            axes.set_xlabel("trial")
            axes.xaxis.set_major_locator(MaxNLocator(integer=True))
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axes.yaxis.set_minor_formatter(NullFormatter())
            axes.legend(loc="best", fontsize=7.0)
        drawn.savefig(path, facecolor="white")
