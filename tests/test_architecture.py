"""Every file keeps the rules of the rooms; each rule is shown to fail on a snippet that breaks it."""

import gc
from collections import Counter
from collections.abc import Iterator
from pathlib import PurePosixPath

import pytest

from tests.rooms import (
    CODE_LINES,
    COMMANDS,
    LAYERS,
    MOST_MODULES,
    ROOMS,
    ROOT,
    RULES,
    Rule,
    campaigns_foresee_nothing,
    circles,
    code_lines,
    drivers_import_nothing_of_ours,
    estimation_is_pure,
    files_stay_short,
    flight_code_knows_no_simulator,
    imports,
    mathematics_knows_no_keys,
    module_of,
    nodes,
    only_the_command_line_prints,
    only_transports_and_runners_read_clocks,
    parsed,
    rooms_stand_on_those_before_them,
    shared_names,
    simulator_knows_the_ports_only,
    sources,
    strangers_use_different_dynamics,
    table,
    the_python_interface_only_re_exports,
    transports_alone_open_buses,
    within,
)


@pytest.fixture(scope="module")
def package_sources() -> Iterator[dict[str, str]]:
    gc.disable()  # trees are kept: looking for what has died among them takes longer than they do
    yield sources()
    for each in (parsed, nodes, imports, code_lines):  # 200 MB
        each.cache_clear()
    gc.enable()


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


def test_a_class_name_has_one_meaning(package_sources: dict[str, str]) -> None:
    bench = {path.as_posix(): path.read_text(encoding="utf-8") for path in (ROOT / "bench").rglob("*.py")}
    assert shared_names(package_sources | bench) == {}
    twice = {"onboard/a.py": "class A: ...\nclass _B: ...", "onboard/c/b.py": "class A: ...\nclass _B: ..."}
    assert shared_names(twice) == {"A": ["onboard/a.py", "onboard/c/b.py"]}
    assert shared_names({**twice, "onboard/c/b.py": "", "hil_sim/a.py": "class A: ..."}) == {
        "A": ["onboard/a.py", "hil_sim/a.py"]
    }


def test_the_table_has_every_room(package_sources: dict[str, str]) -> None:
    drawn = table(dict.fromkeys(package_sources, ""))  # lines are counted above
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
    (mathematics_knows_no_keys, "onboard/identification/free_flyer/online.py", "key = f'device.{name}.scale_sigma'"),
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
        "onboard/estimation/recursive/least_squares.py",
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
    (mathematics_knows_no_keys, "onboard/flight/estimate/problem/sigma_keys.py", "key = 'imu_prior.position_m'"),
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
        "from onboard.ground.api.flight_log import Table\nt = Table",
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
