"""Rules of the rooms: what each may import, who may read a clock. Read from the syntax trees; nothing is imported.

Every rule is a function of a file's path and source. As a script (``python -m tests.rooms``) it prints the table of the
rooms.
"""

import ast
import io
import re
import sys
import tokenize
from collections import Counter
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path, PurePosixPath
from typing import NamedTuple

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

    by_call = "import_module" in source or "__import__" in source  # else only statements import
    into = ast.AST if by_call else (ast.stmt, ast.ExceptHandler, ast.match_case)
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
        waiting += [(child, inside) for child in ast.iter_child_nodes(node) if isinstance(child, into)]
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
    """NumPy, SciPy, filterpy, the standard library, the compiled core, and itself."""
    if not path.startswith("onboard/estimation"):
        return []
    known = {"filterpy", "numpy", "scipy", *sys.stdlib_module_names}
    return [
        f"{path}:{i.line}: {i.name}"
        for i in imports(path, source)
        if not within(i.name, "onboard.native", "onboard.estimation", *known)
        or within(i.name, "logging", "time", "pathlib", "os", "io")
    ]


LAYERS = {  # of a package: each room may import those before it, and itself; every room is here
    "onboard": (
        *("native", "estimation", "dynamics", "regressor", "identification", "control"),
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


def shared_names(tree: Mapping[str, str]) -> dict[str, list[str]]:
    """Public classes that have a name in common, by that name: the files that define them."""
    found: dict[str, list[str]] = {}
    for path, source in tree.items():
        for name in (node.name for node in nodes(path, source) if isinstance(node, ast.ClassDef)):
            if not name.startswith("_"):
                found.setdefault(name, []).append(path)
    return {name: paths for name, paths in found.items() if len(paths) > 1}


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


if __name__ == "__main__":
    sys.stdout.write(table(sources()) + "\n")
