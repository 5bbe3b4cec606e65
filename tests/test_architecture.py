"""The rooms, what each may import, who may read a clock. Read from the syntax trees; nothing is imported.

Every rule is a function of a file's path and source, so that each is shown to fail on a snippet that breaks it.
"""

import ast
import io
import re
import sys
import tokenize
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
OURS = {"drivers", "onboard", "hil_sim", "heft", "tests", "bench"}
ROOMS = ("drivers", "onboard", "hil_sim", "heft")
BUS_LIBRARIES = {"smbus2", "can", "serial", "gpiod"}
CODE_LINES = 300

CLOCKS = {
    *(f"time.{name}" for name in ("time", "monotonic", "perf_counter", "process_time", "thread_time", "clock_gettime")),
    *(
        f"time.{name}_ns"
        for name in ("time", "monotonic", "perf_counter", "process_time", "thread_time", "clock_gettime")
    ),
    *(f"datetime.datetime.{name}" for name in ("now", "utcnow", "today")),
    "datetime.date.today",
}
RUNNERS = (
    *("onboard/flight/supervise/runner*.py", "onboard/flight/supervise/workers.py"),
    *("onboard/telemetry/process.py", "hil_sim/serve*.py", "onboard/cli/*", "bench/*"),
)
CLOCK_READERS = ("drivers/transports/*", "drivers/transports/can/*", *RUNNERS)
PRINTERS = ("onboard/cli/*", "bench/*")


class Import(NamedTuple):
    """One imported name: ``from a import b`` is ``a.b``. ``lazy`` when inside a function."""

    line: int
    name: str
    lazy: bool


def module_of(path: str) -> str:
    """``drivers/mpu6050/__init__.py`` is ``drivers.mpu6050``."""
    parts = PurePosixPath(path).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def within(name: str, *packages: str) -> bool:
    """Is ``name`` one of these packages or inside one?"""
    return any(name == package or name.startswith(f"{package}.") for package in packages)


def allowed(path: str, patterns: tuple[str, ...]) -> bool:
    return any(PurePosixPath(path).match(pattern) for pattern in patterns)


@cache
def parsed(path: str, source: str) -> ast.Module:
    """The syntax tree of a file, for all rules."""
    return ast.parse(source, path)


@cache
def nodes(path: str, source: str) -> tuple[ast.AST, ...]:
    """All nodes of that tree."""
    return tuple(ast.walk(parsed(path, source)))


@cache
def imports(path: str, source: str) -> tuple[Import, ...]:
    """Every import of a file, relative ones resolved, ``importlib.import_module("a.b")`` included."""
    package = module_of(path).split(".")
    if not path.endswith("__init__.py"):
        package = package[:-1]

    found: list[Import] = []
    waiting: list[tuple[ast.AST, bool]] = [(parsed(path, source), False)]
    while waiting:
        node, lazy = waiting.pop()
        match node:
            case ast.Import():
                found += [Import(node.lineno, alias.name, lazy) for alias in node.names]
            case ast.ImportFrom():
                base = package[: len(package) - node.level + 1] if node.level else []
                prefix = ".".join([*base, *([node.module] if node.module else [])])
                found += [Import(node.lineno, f"{prefix}.{alias.name}", lazy) for alias in node.names]
            case ast.Call(
                func=ast.Attribute(attr="import_module") | ast.Name(id="import_module" | "__import__"),
                args=[ast.Constant(value=str(name)), *_],
            ):
                found.append(Import(node.lineno, name, lazy))
        inside = lazy or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        waiting += [(child, inside) for child in ast.iter_child_nodes(node)]
    return tuple(sorted(found))


def drivers_import_nothing_of_ours(path: str, source: str) -> list[str]:
    if not path.startswith("drivers/"):
        return []
    return [f"{path}:{i.line}: {i.name}" for i in imports(path, source) if within(i.name, *OURS - {"drivers"})]


def transports_alone_open_buses(path: str, source: str) -> list[str]:
    """Among what flies. hil_sim is the other end of those buses, and has to import the same libraries."""
    if not path.startswith(("drivers/", "onboard/")) or path.startswith("drivers/transports/"):
        return []
    return [f"{path}:{i.line}: {i.name}" for i in imports(path, source) if within(i.name, *BUS_LIBRARIES)]


def estimation_is_pure(path: str, source: str) -> list[str]:
    """NumPy, SciPy, filterpy, the standard library, and itself."""
    if not path.startswith("onboard/estimation"):
        return []
    known = {"filterpy", "numpy", "scipy", *sys.stdlib_module_names}
    return [
        f"{path}:{i.line}: {i.name}"
        for i in imports(path, source)
        if not within(i.name, "onboard.estimation", *known) or within(i.name, "logging", "time", "pathlib", "os", "io")
    ]


LAYERS = {  # of a package: each room may import those before it, and itself; every room is here
    "onboard": (
        *("estimation", "native", "dynamics", "regressor", "identification", "control"),
        *("section", "npz", "ring", "channels", "recording", "timebase", "devices", "config"),
        *("flight", "ground", "live", "telemetry", "page", "cli"),
    ),
    "onboard.flight": (
        *("clocks", "store", "acquire", "estimate", "health", "supervise", "check"),
        *("simulated", "hil", "bench", "trials"),
    ),
    "onboard.ground": ("log", "drawing", "calibrate", "identify", "api", "campaign", "report", "before"),
    "hil_sim": (
        *("arrays", "scenario", "filters", "plants", "sensing", "faults", "devices", "buses"),
        *("arm_rig", "twins", "mission", "bench", "driven_world", "serve", "driven_flight", "kernel"),
        *("serve_arm", "serve_driven"),
    ),
}
KEYS = re.compile(r"\[(estimation|vehicle|device)\b|\b(device|(imu_)?prior)\.[a-z]|^device\.$")
MOST_MODULES = 15  # in a folder
COMMANDS = "onboard/cli"  # a module a command: as many as there are
MATHEMATICS = (
    "estimation",
    "native",
    "dynamics",
    "regressor",
    "identification",
    "control",
)  # import nothing else of onboard


def rooms_stand_on_those_before_them(path: str, source: str) -> list[str]:
    beyond: list[Import] = []
    for top, order in LAYERS.items():
        room = module_of(path).removeprefix(f"{top}.").split(".")[0]
        if not within(module_of(path), top) or room not in order:
            continue
        below = {f"{top}.{name}" for name in order[: order.index(room) + 1]}
        judged = OURS if top == "onboard" and room in MATHEMATICS else {f"{top}.{name}" for name in order}
        beyond += [i for i in imports(path, source) if within(i.name, *judged) and not within(i.name, *below)]
    return [f"{path}:{i.line}: {i.name}" for i in beyond]


def simulator_knows_the_ports_only(path: str, source: str) -> list[str]:
    if not path.startswith("hil_sim/"):
        return []
    names = [i for i in imports(path, source) if within(i.name, *OURS)]
    return [f"{path}:{i.line}: {i.name}" for i in names if not within(i.name, "hil_sim", "drivers.ports")]


def flight_code_knows_no_simulator(path: str, source: str) -> list[str]:
    """But for the command line, which fetches it when a command asks for it."""
    if not path.startswith(("onboard/", "drivers/")):
        return []
    names = [i for i in imports(path, source) if within(i.name, "hil_sim")]
    return [f"{path}:{i.line}: {i.name}" for i in names if not (allowed(path, ("onboard/cli/*",)) and i.lazy)]


def strangers_use_different_dynamics(path: str, source: str) -> list[str]:
    """MuJoCo moves the simulated bodies, Pinocchio makes the regressor; neither side sees the other's."""
    theirs = {"hil_sim": "pinocchio", "onboard": "mujoco", "drivers": "mujoco"}.get(path.split("/", maxsplit=1)[0])
    return [f"{path}:{i.line}: {i.name}" for i in imports(path, source) if theirs and within(i.name, theirs)]


def mathematics_knows_no_keys(path: str, source: str) -> list[str]:
    """Configuration says which key of vehicle.toml states a parameter."""
    if module_of(path).removeprefix("onboard.").split(".")[0] not in MATHEMATICS:
        return []
    documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    docs = [n.body[0] for n in nodes(path, source) if isinstance(n, documented) and ast.get_docstring(n) is not None]
    silent = {id(doc.value) for doc in docs if isinstance(doc, ast.Expr)}
    texts = [n for n in nodes(path, source) if isinstance(n, ast.Constant) and id(n) not in silent]
    return [f"{path}:{n.lineno}: {n.value}" for n in texts if isinstance(n.value, str) and KEYS.search(n.value)]


def campaigns_foresee_nothing(path: str, source: str) -> list[str]:
    """The table before a flight is for who waits for it."""
    if not path.startswith("onboard/ground/campaign/"):
        return []
    return [
        f"{path}:{i.line}: {i.name}" for i in imports(path, source) if within(i.name, "onboard.ground.before.foresee")
    ]


def only_the_command_line_prints(path: str, source: str) -> list[str]:
    if allowed(path, PRINTERS):
        return []
    calls = (node for node in nodes(path, source) if isinstance(node, ast.Call))
    return [f"{path}:{c.lineno}: print" for c in calls if isinstance(c.func, ast.Name) and c.func.id == "print"]


def only_transports_and_runners_read_clocks(path: str, source: str) -> list[str]:
    """A reference counts as a call: a clock handed on as an argument is read somewhere else."""
    if allowed(path, CLOCK_READERS):
        return []
    bound: dict[str, str] = {}  # local name -> what it stands for
    for node in nodes(path, source):
        if isinstance(node, ast.Import):
            bound |= {alias.asname or alias.name.split(".")[0]: alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            bound |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}

    def dotted(node: ast.AST) -> str:
        match node:
            case ast.Name():
                return bound.get(node.id, "")
            case ast.Attribute():
                return f"{dotted(node.value)}.{node.attr}"
        return ""

    names = (node for node in nodes(path, source) if isinstance(node, ast.Name | ast.Attribute))
    return [f"{path}:{node.lineno}: {dotted(node)}" for node in names if dotted(node) in CLOCKS]


@cache
def code_lines(path: str, source: str) -> int:
    """Lines that hold code: not blank, not a comment, not a docstring."""
    silent = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in silent:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in nodes(path, source):
        if (
            isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
            and ast.get_docstring(node, clean=False) is not None
        ):
            lines.difference_update(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    return len(lines)


def files_stay_short(path: str, source: str) -> list[str]:
    if source.count("\n") < CODE_LINES or (lines := code_lines(path, source)) <= CODE_LINES:
        return []
    return [f"{path}: {lines} lines of code"]


def the_python_interface_only_re_exports(path: str, source: str) -> list[str]:
    """``heft`` names what ``onboard.ground`` defines; nobody of ours imports it."""
    if not path.startswith("heft/"):
        return [f"{path}:{i.line}: {i.name}" for i in imports(path, source) if within(i.name, "heft")]
    made = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Lambda
    found = [f"{path}:{n.lineno}: a definition" for n in nodes(path, source) if isinstance(n, made)]
    names = [i for i in imports(path, source) if not within(i.name, "onboard.ground")]
    return found + [f"{path}:{i.line}: {i.name}" for i in names]


def circles(tree: Mapping[str, str]) -> list[list[str]]:
    """Siblings that import each other, directly or around a corner: modules and packages, in every package.

    Imports inside functions and of types alone count. ``a/__init__.py`` is ``a`` to other packages and ``a.__init__``
    to the modules beside it.
    """
    packages = {module_of(path) for path in tree if path.endswith("__init__.py")}
    modules = {module_of(path) for path in tree}
    edges: dict[str, set[str]] = {}
    for path, source in tree.items():
        for name in (i.name for i in imports(path, source)):
            target = name if name in modules else name.rpartition(".")[0]
            if target in modules:
                ends = [[*one.split("."), *["__init__"] * (one in packages)] for one in (module_of(path), target)]
                apart = [k for k, (a, b) in enumerate(zip(*ends, strict=False), 1) if a != b][:1]
                for k in apart:  # the first level at which they differ
                    edges.setdefault(".".join(ends[0][:k]), set()).add(".".join(ends[1][:k]))

    def reachable(start: str) -> set[str]:
        seen: set[str] = set()
        waiting = [*edges[start]]
        while waiting:
            if (name := waiting.pop()) not in seen:
                seen.add(name)
                waiting += edges.get(name, ())
        return seen

    reach = {name: reachable(name) for name in edges}
    tangles = {frozenset(b for b in reach[a] if a in reach.get(b, ())) for a in edges if a in reach[a]}
    return sorted(sorted(tangle) for tangle in tangles)


def table(tree: Mapping[str, str]) -> str:
    """Floor, number of files, size of the largest folder and lines of code of each room, and all circles."""
    lines = [f"{'room':28}{'floor':>6}{'files':>7}{'largest folder':>16}{'code lines':>12}"]
    for top in ("drivers", "onboard", "onboard.flight", "onboard.ground", "hil_sim", "heft"):
        rooms: dict[str, dict[str, str]] = {}
        for path, source in tree.items():
            if within(module_of(path), top) and module_of(path) != top:
                rooms.setdefault(module_of(path).removeprefix(f"{top}.").split(".")[0], {})[path] = source
        order = LAYERS.get(top, tuple(rooms))
        for room, files in sorted(rooms.items(), key=lambda one: order.index(one[0])):
            most = max(Counter(PurePosixPath(path).parent for path in files).values())
            code = sum(code_lines(path, source) for path, source in files.items())
            lines.append(f"{top + '.' + room:28}{order.index(room) + 1:6}{len(files):7}{most:16}{code:12,}")
    return "\n".join([*lines, f"circles: {circles(tree) or 'none'}"])


Rule = Callable[[str, str], list[str]]
RULES: tuple[Rule, ...] = (
    drivers_import_nothing_of_ours,
    transports_alone_open_buses,
    estimation_is_pure,
    rooms_stand_on_those_before_them,
    simulator_knows_the_ports_only,
    flight_code_knows_no_simulator,
    strangers_use_different_dynamics,
    mathematics_knows_no_keys,
    campaigns_foresee_nothing,
    only_the_command_line_prints,
    only_transports_and_runners_read_clocks,
    files_stay_short,
    the_python_interface_only_re_exports,
)


def sources() -> dict[str, str]:
    paths = [path for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]
    return {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in paths}


@pytest.fixture(scope="module")
def package_sources() -> Iterator[dict[str, str]]:
    yield sources()
    for each in (parsed, nodes, imports, code_lines):  # 200 MB
        each.cache_clear()


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_the_tree_keeps(rule: Rule, package_sources: dict[str, str]) -> None:
    assert {path.split("/")[0] for path in package_sources} == set(ROOMS)
    assert [broken for path, source in package_sources.items() for broken in rule(path, source)] == []


def test_files_of_the_bench_stay_short() -> None:
    paths = sorted((ROOT / "bench").rglob("*.py"))
    assert len(paths) > 20
    assert [broken for path in paths for broken in files_stay_short(path.name, path.read_text(encoding="utf-8"))] == []


def test_no_folder_is_crowded(package_sources: dict[str, str]) -> None:
    folders = Counter(PurePosixPath(path).parent.as_posix() for path in package_sources)
    assert {folder for folder, count in folders.items() if count > MOST_MODULES} == {COMMANDS}


def test_every_room_has_its_floor(package_sources: dict[str, str]) -> None:
    for top, order in LAYERS.items():
        inside = {module_of(path).removeprefix(f"{top}.") for path in package_sources if within(module_of(path), top)}
        assert {name.split(".")[0] for name in inside if name != top} == set(order)


def test_nothing_imports_in_a_circle(package_sources: dict[str, str]) -> None:
    assert circles(package_sources) == []


def shared_names(tree: Mapping[str, str]) -> dict[str, list[str]]:
    """Public classes of a package that have a name in common, by that name: the files that define them."""
    found: dict[str, list[str]] = {}
    for path, source in tree.items():
        for name in (node.name for node in nodes(path, source) if isinstance(node, ast.ClassDef)):
            if not name.startswith("_"):
                found.setdefault(f"{path.split('/')[0]}: {name}", []).append(path)
    return {name: paths for name, paths in found.items() if len(paths) > 1}


def test_a_class_name_has_one_meaning_in_a_package(package_sources: dict[str, str]) -> None:
    assert shared_names(package_sources) == {}
    twice = {"onboard/a.py": "class A: ...\nclass _B: ...", "onboard/c/b.py": "class A: ...\nclass _B: ..."}
    assert shared_names(twice) == {"onboard: A": ["onboard/a.py", "onboard/c/b.py"]}
    assert shared_names({**twice, "onboard/c/b.py": "", "hil_sim/a.py": "class A: ..."}) == {}


def test_the_table_has_every_room(package_sources: dict[str, str]) -> None:
    drawn = table(package_sources)
    assert all(f"{top}.{room} " in drawn for top, order in LAYERS.items() for room in order)


BREACHES: list[tuple[Rule, str, str]] = [
    (drivers_import_nothing_of_ours, "drivers/mpu6050/device.py", "import onboard.ring"),
    (drivers_import_nothing_of_ours, "drivers/mpu6050/device.py", "from hil_sim.devices import mpu6050"),
    (drivers_import_nothing_of_ours, "drivers/ports.py", "from onboard import ring"),
    (drivers_import_nothing_of_ours, "drivers/ports.py", "def f():\n    from onboard import ring"),
    (drivers_import_nothing_of_ours, "drivers/ports.py", "import importlib\nimportlib.import_module('onboard.ring')"),
    (transports_alone_open_buses, "drivers/mpu6050/device.py", "import smbus2"),
    (transports_alone_open_buses, "drivers/canopen_pdo/device.py", "from can.interfaces import virtual"),
    (transports_alone_open_buses, "drivers/qsb/device.py", "import serial.tools.list_ports"),
    (transports_alone_open_buses, "onboard/flight/acquire/acquisition.py", "from gpiod.line import Edge"),
    (estimation_is_pure, "onboard/estimation/recursive/rls.py", "from onboard.dynamics import rows"),
    (estimation_is_pure, "onboard/estimation/recursive/rls.py", "from ... import ring"),
    (estimation_is_pure, "onboard/estimation/recursive/rls.py", "import drivers.records"),
    (estimation_is_pure, "onboard/estimation/recursive/rls.py", "import pinocchio"),
    (estimation_is_pure, "onboard/estimation/recursive/rls.py", "import logging"),
    (estimation_is_pure, "onboard/estimation/recursive/rls.py", "from pathlib import Path"),
    (rooms_stand_on_those_before_them, "onboard/regressor/rows.py", "from onboard.config import Vehicle"),
    (rooms_stand_on_those_before_them, "onboard/dynamics/model/vehicle.py", "from onboard.regressor import rows"),
    (
        rooms_stand_on_those_before_them,
        "onboard/flight/estimate/estimator.py",
        "def f():\n    from onboard.ground import views",
    ),
    (rooms_stand_on_those_before_them, "onboard/devices/serial_line/qsb.py", "from onboard.config import Vehicle"),
    (rooms_stand_on_those_before_them, "hil_sim/plants/world.py", "from hil_sim.sensing import analog"),
    (
        rooms_stand_on_those_before_them,
        "onboard/flight/acquire/publisher.py",
        "from onboard.flight.estimate import signals",
    ),
    (rooms_stand_on_those_before_them, "hil_sim/twins.py", "from hil_sim import mission"),
    (rooms_stand_on_those_before_them, "onboard/regressor/rows.py", "from ..flight import modes"),
    (rooms_stand_on_those_before_them, "onboard/regressor/rows.py", "from drivers import records"),
    (simulator_knows_the_ports_only, "hil_sim/devices/mpu6050/chip.py", "from drivers.mpu6050 import registers"),
    (simulator_knows_the_ports_only, "hil_sim/devices/mpu6050/chip.py", "from drivers import records"),
    (simulator_knows_the_ports_only, "hil_sim/devices/mpu6050/chip.py", "import drivers"),
    (simulator_knows_the_ports_only, "hil_sim/devices/mpu6050/chip.py", "import drivers.ports_of_call"),
    (simulator_knows_the_ports_only, "hil_sim/plants/servo_flight.py", "from onboard.config import load"),
    (flight_code_knows_no_simulator, "onboard/flight/supervise/runner.py", "def f():\n    import hil_sim.serve"),
    (flight_code_knows_no_simulator, "onboard/cli/flying.py", "from hil_sim import serve"),
    (flight_code_knows_no_simulator, "onboard/cli/flying.py", "if True:\n    import hil_sim"),
    (strangers_use_different_dynamics, "hil_sim/plants/servo_flight.py", "import pinocchio as pin"),
    (
        campaigns_foresee_nothing,
        "onboard/ground/campaign/flights.py",
        "def f():\n    from onboard.ground.before.foresee.kept import kept",
    ),
    (strangers_use_different_dynamics, "onboard/regressor/rows.py", "from mujoco import MjModel"),
    (mathematics_knows_no_keys, "onboard/identification/exiddm/online.py", "key = f'device.{name}.scale_sigma'"),
    (mathematics_knows_no_keys, "onboard/regressor/prior.py", "raise ValueError('state it in [estimation.prior]')"),
    (only_the_command_line_prints, "onboard/flight/supervise/runner.py", "print('tick')"),
    (only_the_command_line_prints, "hil_sim/serve.py", "def f():\n    print()"),
    (only_transports_and_runners_read_clocks, "onboard/ring.py", "import time\ntime.monotonic_ns()"),
    (only_transports_and_runners_read_clocks, "onboard/ring.py", "import time as t\nt.time()"),
    (only_transports_and_runners_read_clocks, "onboard/ring.py", "from time import monotonic\nmonotonic()"),
    (only_transports_and_runners_read_clocks, "onboard/ring.py", "import time\ndef f(now=time.time_ns): ..."),
    (only_transports_and_runners_read_clocks, "onboard/ring.py", "from time import perf_counter_ns as now\nf(now)"),
    (only_transports_and_runners_read_clocks, "drivers/ports.py", "import datetime\ndatetime.datetime.now()"),
    (
        only_transports_and_runners_read_clocks,
        "hil_sim/plants/servo_flight.py",
        "from datetime import datetime as D\nD.utcnow()",
    ),
    (
        only_transports_and_runners_read_clocks,
        "hil_sim/plants/motions/carrier.py",
        "import time\ntime.clock_gettime_ns(1)",
    ),
    (files_stay_short, "onboard/ring.py", "a = 1\n" * (CODE_LINES + 1)),
    (files_stay_short, "onboard/ring.py", "a = [\n" + "1,\n" * CODE_LINES + "]"),
    (the_python_interface_only_re_exports, "heft/__init__.py", "def f(): ..."),
    (the_python_interface_only_re_exports, "heft/__init__.py", "from onboard.flight import runner"),
    (the_python_interface_only_re_exports, "onboard/cli/dump.py", "import heft"),
]

INNOCENT: list[tuple[Rule, str, str]] = [
    (
        rooms_stand_on_those_before_them,
        "onboard/flight/supervise/workers.py",
        "from onboard.flight.estimate import signals\nfrom onboard.flight.supervise import modes",
    ),
    (drivers_import_nothing_of_ours, "drivers/mpu6050/device.py", "from drivers import ports\nfrom ..errors import X"),
    (drivers_import_nothing_of_ours, "onboard/ring.py", "import onboard"),
    (transports_alone_open_buses, "drivers/transports/i2c.py", "import smbus2"),
    (transports_alone_open_buses, "drivers/canopen_pdo/decode.py", "from drivers import canopen_pdo\nimport candid"),
    (transports_alone_open_buses, "hil_sim/buses/media.py", "import can, serial, smbus2"),
    (
        estimation_is_pure,
        "onboard/estimation/recursive/rls.py",
        "import math\nimport numpy as np\nfrom scipy.linalg import lapack",
    ),
    (
        estimation_is_pure,
        "onboard/estimation/recursive/window.py",
        "from .rls import R\nfrom onboard.estimation import rls",
    ),
    (
        rooms_stand_on_those_before_them,
        "onboard/regressor/rows.py",
        "import pinocchio\nfrom ..estimation import rls\nfrom onboard.dynamics import inertia",
    ),
    (
        simulator_knows_the_ports_only,
        "hil_sim/devices/mpu6050/chip.py",
        "from drivers.ports import Edge\nfrom .. import faults",
    ),
    (simulator_knows_the_ports_only, "hil_sim/buses/media.py", "from drivers import ports"),
    (flight_code_knows_no_simulator, "onboard/cli/flying.py", "def hil():\n    from hil_sim import serve"),
    (strangers_use_different_dynamics, "hil_sim/plants/servo_flight.py", "import mujoco"),
    (
        campaigns_foresee_nothing,
        "onboard/ground/before/planning/planning.py",
        "from onboard.ground.before.foresee import foresee",
    ),
    (mathematics_knows_no_keys, "onboard/flight/estimate/problem/exiddm_keys.py", "key = 'imu_prior.position_m'"),
    (mathematics_knows_no_keys, "onboard/regressor/prior.py", "raise ValueError(f'no {device.name} in the prior.')"),
    (only_the_command_line_prints, "onboard/cli/looking.py", "print()"),
    (only_the_command_line_prints, "onboard/ground/report.py", "console.print()\nprint_table()"),
    (only_transports_and_runners_read_clocks, "drivers/transports/i2c.py", "import time\ntime.monotonic_ns()"),
    (
        only_transports_and_runners_read_clocks,
        "onboard/flight/supervise/runner_real.py",
        "import time\ntime.monotonic_ns()",
    ),
    (
        only_transports_and_runners_read_clocks,
        "onboard/ring.py",
        "import time\nclock.time()\nsample.time\ntime.sleep(1)",
    ),
    (files_stay_short, "onboard/ring.py", '"""Doc.\n' + "x\n" * CODE_LINES + '"""\n' + "# y\n\n" * CODE_LINES),
    (
        the_python_interface_only_re_exports,
        "heft/__init__.py",
        "from onboard.ground.api.table import Table\nt = Table",
    ),
]


def snippet_id(value: object) -> str | None:
    return getattr(value, "__name__", None)


@pytest.mark.parametrize(("rule", "path", "source"), BREACHES, ids=snippet_id)
def test_a_breach_is_seen(rule: Rule, path: str, source: str) -> None:
    assert len(rule(path, source)) == 1


@pytest.mark.parametrize(("rule", "path", "source"), INNOCENT, ids=snippet_id)
def test_the_innocent_pass(rule: Rule, path: str, source: str) -> None:
    assert rule(path, source) == []


def test_every_rule_has_a_breach_and_an_innocent() -> None:
    assert {rule for rule, *_ in BREACHES} == set(RULES)
    assert {rule for rule, *_ in INNOCENT} == set(RULES)


def test_circles_are_seen_at_every_depth_and_shared_ground_is_none() -> None:
    around_the_corner = {
        "onboard/a.py": "from onboard.b import deep",
        "onboard/b/deep.py": "def f():\n    from .. import c",
        "onboard/b/__init__.py": "",
        "onboard/c.py": "import onboard.a",
        "onboard/d.py": "from onboard import a, c",
    }
    assert circles(around_the_corner) == [["onboard.a", "onboard.b", "onboard.c"]]
    del around_the_corner["onboard/c.py"]
    assert circles(around_the_corner) == []
    inside = {"onboard/b/x.py": "from .y import z", "onboard/b/y.py": "from . import x", "onboard/b/__init__.py": ""}
    assert circles(inside) == [["onboard.b.x", "onboard.b.y"]]
    of_its_package = {"onboard/b/x.py": "from onboard.b import z", "onboard/b/__init__.py": "from onboard.b.x import y"}
    assert circles(of_its_package) == [["onboard.b.__init__", "onboard.b.x"]]
    assert circles({"onboard/b/__init__.py": "from onboard.b.x import y", "onboard/b/x.py": "import onboard.c"}) == []


if __name__ == "__main__":
    sys.stdout.write(table(sources()) + "\n")
