"""Draws docs/architecture.svg and docs/sample.svg: rooms and their imports, and the way of one sample, from the code.

``python -m bench.architecture_picture docs/architecture.svg docs/sample.svg`` reads the syntax trees of the packages;
nothing is flown. A step of the sample's way whose module is gone is an error.
"""

import ast
import importlib
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

ROOT: Final = Path(__file__).resolve().parents[1]
PACKAGES: Final = ("drivers", "onboard", "hil_sim", "heft")
OPENED: Final = ("onboard",)
"""Packages of which each room is a box; another one is a box by itself."""
COLOURS: Final = {"drivers": "#f3d9b1", "onboard": "#cfe2f3", "hil_sim": "#d9ead3", "heft": "#e3d7ef"}
STEPS: Final = (  # of one sample: module, what it hands on
    ("drivers.transports", "bytes of the bus"),
    ("drivers.device", "a record: counts, tick, arrival"),
    ("onboard.ring", "rows in shared memory"),
    ("onboard.timebase", "vehicle time and its sigma"),
    ("onboard.flight.estimate", "smoothed signals at even ticks"),
    ("onboard.regressor.rows", "rows y = Y chi"),
    ("onboard.identification", "estimate, interval, level"),
    ("onboard.recording.recorder", "log: raw rows and answers"),
)


def room_of(module: str) -> str:
    """``onboard.timebase.timebase`` is ``onboard.timebase``, ``hil_sim.mission`` is ``hil_sim``; empty if not ours."""
    top, _, rest = module.partition(".")
    if top not in PACKAGES:
        return ""
    return f"{top}.{rest.split('.')[0]}" if top in OPENED and rest else top


def modules(root: Path) -> Iterator[tuple[str, tuple[str, ...], Path]]:
    """Each module of a room: its room, the parts of its name (the last one of a package is empty), its file."""
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            here = parts if path.name != "__init__.py" else (*parts[:-1], "")
            room = room_of(".".join(part for part in here if part))
            if room not in OPENED:  # the package's own __init__
                yield room, here, path


def imports(root: Path) -> dict[str, set[str]]:
    """The rooms that each room imports."""
    found: dict[str, set[str]] = {}
    for room, here, path in modules(root):
        names = found.setdefault(room, set())
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {room_of(alias.name) for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                base = [*here[: -node.level], node.module or ""] if node.level else [node.module or ""]
                names |= {room_of(".".join(filter(None, [*base, alias.name]))) for alias in node.names}
    return {room: {name for name in names if name in found} - {room} for room, names in found.items()}


def floors(edges: Mapping[str, set[str]]) -> dict[str, int]:
    """How far each room stands above those that import nothing of ours.

    Raises:
        ValueError: Rooms import each other in a circle.
    """
    level: dict[str, int] = {}
    while len(level) < len(edges):
        ready = [room for room in edges if room not in level and edges[room] <= level.keys()]
        if not ready:
            raise ValueError(f"rooms import each other: {sorted(edges.keys() - level.keys())}")
        level |= {room: 1 + max((level[name] for name in edges[room]), default=-1) for room in ready}
    return level


def reduced(edges: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """The imports that do not follow from others (transitive reduction)."""

    def reach(room: str) -> set[str]:
        return edges[room].union(*(reach(name) for name in edges[room]))

    return {room: names - set().union(*(reach(name) for name in names)) for room, names in edges.items()}


def draw_rooms(edges: Mapping[str, set[str]], output: Path) -> None:
    """Boxes by floors, the lowest at the bottom, an arrow from each room to what it imports."""
    level = floors(edges)
    rows = [[room for room in edges if level[room] == floor] for floor in range(max(level.values()) + 1)]
    place: dict[str, tuple[float, float]] = {}
    for floor, rooms in enumerate(rows):
        below = {room: [place[name][0] for name in edges[room] if name in place] for room in rooms}
        rooms.sort(key=lambda room: sum(below[room]) / len(below[room]) if below[room] else 0.5)
        place |= {room: ((at + 0.5) / len(rooms), float(floor)) for at, room in enumerate(rooms)}
    figure = Figure(figsize=(7.6, 0.72 * len(rows) + 0.2), layout="constrained")
    axes = figure.subplots()
    axes.set(xlim=(0.0, 1.0), ylim=(-0.4, len(rows) - 0.6))
    axes.axis("off")
    for room, names in sorted(reduced(edges).items()):
        for name in sorted(names):
            (x, y), (x_to, y_to) = place[room], place[name]
            axes.annotate(
                "",
                (x_to, y_to + 0.21),
                (x, y - 0.21),
                arrowprops={"arrowstyle": "-|>", "color": "0.55", "lw": 0.8, "shrinkA": 0, "shrinkB": 0},
            )
    for room, (x, y) in place.items():
        colour = COLOURS[room.split(".")[0]]
        box = {"boxstyle": "round,pad=0.35", "fc": colour, "ec": "0.4", "lw": 0.7}
        axes.text(x, y, room.removeprefix("onboard."), ha="center", va="center", fontsize=9, zorder=3, bbox=box)
    figure.savefig(output, metadata={"Date": None}, facecolor="white")


def draw_sample(output: Path) -> None:
    """The steps of one sample, each by the module that does it.

    Raises:
        ImportError: A module is gone.
    """
    figure = Figure(figsize=(7.6, 2.5), layout="constrained")
    axes = figure.subplots()
    half = len(STEPS) // 2
    axes.set(xlim=(0.0, half), ylim=(-0.1, 2.0))
    axes.axis("off")
    for at, (module, handed_on) in enumerate(STEPS):
        importlib.import_module(module)
        x, y = at % half, 1.05 if at < half else 0.0
        colour = COLOURS[module.split(".")[0]]
        axes.add_patch(FancyBboxPatch((x + 0.06, y + 0.1), 0.78, 0.6, boxstyle="round,pad=0.03", fc=colour, ec="0.4"))
        title = module.removeprefix("onboard.").replace(".", ".\n", 1) if len(module) > 20 else module
        axes.text(x + 0.45, y + 0.5, title, ha="center", va="center", fontsize=8, weight="bold")
        words = handed_on.split()
        middle = (len(words) + 1) // 2
        text = "\n".join(filter(None, (" ".join(words[:middle]), " ".join(words[middle:]))))
        axes.text(x + 0.45, y + 0.22, text, ha="center", va="center", fontsize=7)
        if at % half < half - 1:
            axes.annotate(
                "", (x + 1.03, y + 0.4), (x + 0.87, y + 0.4), arrowprops={"arrowstyle": "-|>", "color": "0.4"}
            )
    axes.annotate("", (0.45, 0.75), (half - 0.55, 1.1), arrowprops={"arrowstyle": "-|>", "color": "0.4"})
    figure.savefig(output, metadata={"Date": None}, facecolor="white")


if __name__ == "__main__":
    mpl.rcParams.update({"svg.hashsalt": "heft", "svg.fonttype": "none"})
    draw_rooms(imports(ROOT), Path(sys.argv[1]))
    draw_sample(Path(sys.argv[2]))
