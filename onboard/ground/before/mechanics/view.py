"""Tables and figures of :class:`onboard.ground.before.mechanics.analysis.Mechanics`."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.console import Group, RenderableType
from rich.table import Column, Table
from rich.text import Text
from scipy.spatial.transform import Rotation

from onboard.ground.before.mechanics.analysis import LineMotion, Mechanics
from onboard.ground.drawing.theme import CYCLE, figures, subplots


def render(found: Mechanics) -> RenderableType:
    """The results as tables."""
    at = ", ".join(f"{name} {np.rad2deg(value):.4g}" for name, value in zip(found.joints, found.q, strict=True))
    parts: list[RenderableType] = [
        Text(f"{found.name}: tip {found.tip}; joints at {at} deg"),
        Text(f"mass {found.mass_kg:.4g} kg; centre of mass {_vector(found.centre_of_mass_m)} m, base axes"),
        Text(f"least singular value of the tip's generalized Jacobian: {found.least_singular_value:.4g} m"),
        Text(),
        _joints(found),
    ]
    if found.virtual_links_m is not None:
        parts += [Text(), _virtual_links(found)]
    parts += [Text(f"base parameters, {base}: {count}") for base, count in found.counts.items()]
    if found.line is not None:
        parts += [Text(), _line(found.line)]
    if found.turn is not None:
        swing = ", ".join(f"{np.rad2deg(x):.1f}" for x in found.turn.swing_rad)
        text = f"base turned by arm cycles alone: {found.turn.cycles} cycle(s), joints swing by {swing} deg"
        parts += [Text(), Text(f"{text}; {np.rad2deg(found.turn.error_rad):.2g} deg from what was asked")]
    if found.map is not None:
        spans = {"reachable": (found.map.reachable,), "path-dependent": found.map.dependent}
        spans["path-independent"] = found.map.independent
        parts.append(Text(f"\nworkspace over {' and '.join(found.map_joints or ())}, m from the centre of mass"))
        for kind, each in spans.items():
            parts.append(Text(f"  {kind}: {', '.join(f'{low:.3f} .. {high:.3f}' for low, high in each) or 'none'}"))
    return Group(*parts)


def _vector(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in values) + ")"


def _joints(found: Mechanics) -> Table:
    headings = ("tip, base floats, m/rad", "tip, base fixed, m/rad", "base turns, rad/rad")
    numbers = (Column(heading, justify="right") for heading in headings)
    table = Table("joint", *numbers, box=None, pad_edge=False, title="a joint by itself", title_justify="left")
    for k, name in enumerate(found.joints):
        parts = found.generalized_jacobian[:3, k], found.fixed_jacobian[:3, k], found.base_per_joint[:, k]
        table.add_row(name, *(" ".join(f"{x:+.3f}" for x in part) for part in parts))
    return table


def _virtual_links(found: Mechanics) -> Table:
    assert found.virtual_links_m is not None
    axes = Column("virtual link in its axes, m", justify="right")
    table = Table("body", axes, box=None, pad_edge=False, title="virtual manipulator", title_justify="left")
    for body, link in zip(("base", *(f"beyond {name}" for name in found.joints)), found.virtual_links_m, strict=True):
        table.add_row(body, " ".join(f"{x:+.4f}" for x in link))
    return table


def _line(line: LineMotion) -> Text:
    moment, momentum = (np.linalg.norm(x, axis=1).max() for x in (line.wheel_moment, line.wheel_momentum))
    return Text(
        f"straight line of the tip: within {1e3 * line.error_m:.2g} mm; base turns by up to "
        f"{np.rad2deg(line.base_turn_rad):.2f} deg; joints up to {line.joint_rate_rad_s:.3g} rad/s\n"
        f"wheels that hold the attitude: up to {momentum:.3g} N m s and {moment:.3g} N m"
    )


def draw(found: Mechanics, directory: Path) -> list[Path]:
    """Figures as SVG files in ``directory``; those of the motions that were asked for."""
    directory.mkdir(parents=True, exist_ok=True)
    made: list[Path] = []
    with figures():
        for name, drawn in (("line", _line_figure(found)), ("workspace", _map_figure(found))):
            if drawn is not None:
                made.append(directory / f"{found.name}_{name}.svg")
                drawn.savefig(made[-1], facecolor="white")
    return made


def _line_figure(found: Mechanics) -> Figure | None:
    """Joints, the floating base and the wheels over time, one above the other."""
    if found.line is None:
        return None
    drawn, (joints, base, wheels) = subplots(3, 1, 1.5, sharex=True)
    t = found.line.motion.time_s
    for k, name in enumerate(found.joints):
        joints.plot(t, np.rad2deg(found.line.motion.q[:, k]), label=name, color=CYCLE[k % len(CYCLE)])
    turn = Rotation.from_matrix(found.line.motion.attitude).as_rotvec(degrees=True)
    for k, axis in enumerate("xyz"):
        base.plot(t, turn[:, k], label=axis)
        wheels.plot(t, found.line.wheel_momentum[:, k], label=axis)
    titles = "joints, deg", "floating base, rotation vector, deg", "wheels that hold the attitude, N m s"
    for axes, title in zip((joints, base, wheels), titles, strict=True):
        axes.set_title(title)
        axes.legend(loc="upper left", ncols=5)
    wheels.set_xlabel("s")
    return drawn


def _map_figure(found: Mechanics) -> Figure | None:
    """The singularity measure and the tip's distance over the two joints; the singular curve in white."""
    if found.map is None or found.map_joints is None:
        return None
    drawn, axes = subplots(1, 2, 3.2)
    first, second = np.rad2deg(found.map.first), np.rad2deg(found.map.second)
    titles = "determinant of J*, m²", "tip from the centre of mass, m"
    for ax, values, title in zip(axes, (found.map.measure, found.map.distance), titles, strict=True):
        drawn.colorbar(ax.pcolormesh(second, first, values, shading="nearest", rasterized=True), ax=ax)
        if found.map.measure.min() < 0.0 < found.map.measure.max():
            ax.contour(second, first, found.map.measure, levels=[0.0], colors="white", linewidths=1.4)
        ax.set_xlabel(f"{found.map_joints[1]}, deg")
        ax.set_ylabel(f"{found.map_joints[0]}, deg")
        ax.set_title(f"{title}; white: singular")
        ax.grid(visible=False)
    return drawn
