"""``heft init``: whatever is asked for is a vehicle at once, or is refused with what to say instead."""

import json
import tomllib
from collections.abc import Iterator
from itertools import combinations, product
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from hil_sim.devices.vehicle_file import scenario_of
from hil_sim.mission import open_in_process
from hil_sim.plants.body import Solid
from hil_sim.plants.draws import as_built
from onboard import cli, config
from onboard.config.keys.schema import as_text
from onboard.dynamics.model.inertia import RigidBody
from onboard.dynamics.model.payload import body_of, standard_of
from onboard.flight.check import scan
from onboard.flight.estimate.problem.identification import build_identifier, build_online
from onboard.flight.estimate.readings.roles import roles_of
from onboard.ground.before.init import vehicle as init_vehicle
from onboard.ground.before.init.vehicle import ENCODERS, IMUS, LOAD_CELLS, NewVehicle, make
from onboard.identification.rows.row_blocks import instrument_of


def _tables(tree: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """A vehicle file's tables with the names of their tables; of [bus] and [device] those in it."""
    for name, table in tree.items():
        if name in ("bus", "device"):
            yield from ((name, one) for one in table.values())
        else:
            yield name, table


def _latin(choice: tuple[tuple[int, Any], ...]) -> int:
    """Orders choices of IMU, encoder and load cell: of the first, no two have a pair in common but of one's places."""
    return (choice[0][0] - choice[1][0] - choice[2][0]) % len(IMUS)


@pytest.fixture(scope="module")
def judged_tables() -> set[str]:
    """What the schema has judged, of all bases: it judges each table by itself."""
    return set()


@pytest.mark.parametrize(
    "base",
    # planar as free; prescribed needs an IMU as free does, and a cell or torques as fixed does
    ["free", "fixed", *(pytest.param(base, marks=pytest.mark.campaign) for base in ("prescribed", "planar"))],
)
def test_every_choice_is_a_vehicle_or_refused(
    base: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, judged_tables: set[str]
) -> None:
    """Every one that is refused; of the others each pair of choices, with and without a pulse."""
    refused, built, loaded = 0, set(), list[config.Vehicle]()
    schema = jsonschema.Draft202012Validator(json.loads(as_text()))

    def build(vehicle: config.Vehicle) -> None:  # make() builds what it has written
        build_online(vehicle)
        loaded.append(vehicle)

    monkeypatch.setattr(init_vehicle, "build_online", build)
    for choice in sorted(product(*map(enumerate, (IMUS, ENCODERS, LOAD_CELLS))), key=_latin):
        (imu, encoder, cell), number = (one for _, one in choice), sum(at for at, _ in choice)
        where = tmp_path / f"{imu}-{encoder}-{cell}"
        pulse = number % 2 == 0  # each device with and without
        wanted = NewVehicle("it", base, ("shoulder", "elbow"), imu, encoder, cell, pulse)  # type: ignore[arg-type]
        needs_cell, needs_imu = base in ("prescribed", "fixed"), base != "fixed"
        wanted_torques = base == "free" or (cell == "none" and needs_cell)  # of the drives, in place of a cell
        alone = encoder == "recorded" and cell == "none" and needs_cell
        torques = 2 if (encoder in ("cia402", "dynamixel", "odrive", "ur_joint") and wanted_torques) or alone else 0
        cells = 6 if cell in ("bota_ft", "net_ft", "onrobot_hex", "robotous_rft", "ur_wrench") else int(cell != "none")
        given = {encoder, *({imu, cell} - {"none"})}
        mixed = "recorded" in given and len(given) > 1
        if mixed or (cell == "none" and needs_cell and not torques) or (imu == "none" and needs_imu):
            refused += 1
            with pytest.raises(config.ConfigError, match=r"give (--|recorded for each device)"):
                make(wanted, where)
            assert not where.exists()
            continue
        if not (pairs := set(combinations(enumerate((imu, encoder, cell, pulse)), 2)) - built):
            continue
        built |= pairs
        make(wanted, where)
        [vehicle] = loaded
        loaded.clear()
        roles = roles_of(vehicle)
        assert [joint.joint for joint in roles.joints] == ["shoulder", "elbow"]
        assert (len(roles.imus), len(roles.cells)) == (imu != "none", torques + cells)
        assert (vehicle.file.estimation.imu_prior.accelerometer_bias_m_s2 > 0.0) == (imu != "none")
        tree = tomllib.loads(vehicle.text)
        if new := {json.dumps(one) for one in _tables(tree)} - judged_tables:
            schema.validate(tree)
            judged_tables |= new
        assert (where / "vehicle.schema.json").read_text() == as_text()
        assert vehicle.text.startswith("#:schema ./vehicle.schema.json\n")
    assert refused == {"free": 343, "planar": 343, "prescribed": 368, "fixed": 272}[base]
    assert len(built) == {"free": 259, "planar": 259, "prescribed": 254, "fixed": 279}[base]


def test_a_packaged_vehicle_is_copied_and_names_its_schema(tmp_path: Path) -> None:
    for name in ("rocksat", "dymaflex", "workshop"):
        assert cli.main(["init", str(tmp_path / name), "--from", name]) == cli.OK
        mine, theirs = config.load(tmp_path / name / "vehicle.toml"), config.load(config.packaged(name))
        assert mine.file == theirs.file
        assert mine.urdf_path.read_bytes() == theirs.urdf_path.read_bytes()


@pytest.mark.parametrize(
    ("asked", "next_step"),
    [
        (["--from", "dymaflex"], "next: heft hil {} rehearses it"),
        (["--from", "tudelft"], "heft import --guess RECORDING --vehicle {} -o MAPPING;"),
        (["--base", "free", "--encoder", "cia406"], "next: heft hil {} rehearses it"),
        (["--base", "fixed", "--encoder", "recorded"], "heft import --guess RECORDING --vehicle {} -o MAPPING, or in "),
    ],
)
def test_the_next_step_is_a_rehearsal_where_devices_are_on_buses_and_else_an_import(
    asked: list[str], next_step: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["init", str(tmp_path / "mine"), *asked]) == cli.OK
    assert next_step.format(tmp_path / "mine" / "vehicle.toml") in capsys.readouterr().out


def test_on_a_terminal_it_asks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = iter(["prescribed", "boom", "", "", "cia404"])
    monkeypatch.setattr(scan, "urls", list)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda question: next(answers))
    assert (
        cli.main(["init", str(tmp_path / "mine"), "--bus", "can_0=can+slcan:///dev/ttyACM0?bitrate=500000"]) == cli.OK
    )
    vehicle = config.load(tmp_path / "mine" / "vehicle.toml")
    assert vehicle.file.vehicle.name == "mine"
    assert vehicle.file.vehicle.base == "prescribed"
    assert [joint.joint for joint in roles_of(vehicle).joints] == ["boom"]
    assert vehicle.url("can_0") == "can+slcan:///dev/ttyACM0?bitrate=500000"


def test_it_offers_what_answers_on_the_buses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    questions = list[str]()

    def answer(question: str) -> str:
        questions.append(question)
        return ""

    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", answer)
    mission, mission_urls = open_in_process("dymaflex", 1, [])
    with mission:
        mission.advance(mission.start_ns + 200_000_000)
        monkeypatch.setattr("time.monotonic_ns", lambda: mission.now_ns)
        monkeypatch.setattr("time.sleep", lambda seconds: mission.advance(mission.now_ns + round(1e9 * seconds)))
        monkeypatch.setattr(scan, "urls", lambda: [mission_urls["i2c_1"], mission_urls["can_0"]])
        assert cli.main(["init", str(tmp_path / "mine")]) == cli.OK
    assert questions[2].endswith(f"; mpu6050 answers on {mission_urls['i2c_1']} [mpu6050] ")
    assert questions[3].endswith(f"; cia406 answers on {mission_urls['can_0']} [cia406] ")
    assert questions[4].endswith(f"; cia404 answers on {mission_urls['can_0']} [cia404] ")
    vehicle = config.load(tmp_path / "mine" / "vehicle.toml")
    assert {name: vehicle.url(name) for name in ("i2c_1", "can_0")} == {
        name: mission_urls[name] for name in ("i2c_1", "can_0")
    }
    assert {one.kind for one in vehicle.file.device.values()} >= {"mpu6050", "cia406", "cia404"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "say what the base is"),
        (["--from", "rocksatt"], "did you mean 'rocksat'?"),
        (["--base", "fixed"], "give --load-cell"),
        (["--base", "free", "--joints", "0"], "heft init --from tudelft, docs/free_body.md"),
        (["--base", "planar", "--joints", "0"], "give --joints, or --thrusters"),
        (["--base", "pivot", "--urdf", "bed.urdf", "--thrusters", "t1"], "on a bearing (--base pivot) or freely"),
        (["--base", "free", "--joints", "a,a"], "once"),
        (["--base", "free", "--joints", 'a"]'], "letters, digits"),
        (["--base", "free", "--name", 'x" y'], "use letters"),
        (["--base", "free", "--bus", "can_9=can+slcan:///dev/x"], "no device stands on it"),
        (["--base", "free", "--bus", "can_0"], "write BUS=URL"),
    ],
)
def test_what_cannot_be_is_refused_and_leaves_nothing(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["init", str(tmp_path / "new"), *arguments]) == cli.BAD_INPUT
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("cell", "bus"),
    [
        *(("bota_ft", "tty_wrist"), ("net_ft", "box"), ("onrobot_hex", "box"), ("robotous_rft", "tty_wrist")),
        ("ur_wrench", "robot"),
    ],
)
def test_a_wrist_sensor_is_six_devices_each_along_its_own_axis(cell: str, bus: str, tmp_path: Path) -> None:
    make(NewVehicle("it", "fixed", ("a", "b"), "none", "ur_joint", cell), tmp_path)
    vehicle = config.load(tmp_path / "vehicle.toml")
    cells = {one.name: one.keys for one in roles_of(vehicle).cells}
    assert [(name, keys.measures, keys.axis.index(1.0)) for name, keys in cells.items()] == [  # type: ignore[union-attr]
        *(("fx", "force", 0), ("fy", "force", 1), ("fz", "force", 2)),
        *(("mx", "moment", 0), ("my", "moment", 1), ("mz", "moment", 2)),
    ]
    assert {vehicle.file.device[name].bus for name in cells} == {bus}  # type: ignore[attr-defined]
    assert {f"bias_{name}" for name in cells} <= vehicle.file.estimation.prior.absolute.keys()


def test_a_vehicle_that_is_there_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "vehicle.toml").write_text("mine")
    assert cli.main(["init", str(tmp_path), "--base", "free"]) == cli.BAD_INPUT
    assert "is there already" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["vehicle.toml"]
    assert (tmp_path / "vehicle.toml").read_text() == "mine"


def test_a_joint_may_be_called_like_the_base(tmp_path: Path) -> None:
    """Its torques are no wrench on a base that floats."""
    made = ["init", str(tmp_path / "v"), "--base", "fixed", "--joints", "base_pan,elbow", "--encoder", "recorded"]
    assert cli.main(made) == cli.OK
    instruments = [instrument_of(name) for name in ("base_pan_torque", "base_force_x", "base_moment_z")]
    assert instruments == ["base_pan_torque", "base IMU", "base IMU"]


def test_the_sigma_of_a_torque_is_by_the_largest_of_its_joint(tmp_path: Path) -> None:
    urdf = Path(__file__).parents[3] / "flight" / "own" / "bench_arm.urdf"
    asked = ["init", str(tmp_path / "own"), "--base", "fixed", "--encoder", "cia402", "--urdf", str(urdf)]
    assert cli.main(asked) == cli.OK
    cells = roles_of(config.load(tmp_path / "own" / "vehicle.toml")).cells
    assert [cell.keys.sigma_N_m for cell in cells] == [0.06, 0.06, 0.04, 0.015, 0.015, 0.008]  # type: ignore[union-attr]
    silent = tmp_path / "silent.urdf"
    silent.write_text(urdf.read_text().replace('effort="60"', 'effort="0"'))
    asked = ["init", str(tmp_path / "silent"), "--base", "fixed", "--encoder", "cia402", "--urdf", str(silent)]
    assert cli.main(asked) == cli.OK
    cells = roles_of(config.load(tmp_path / "silent" / "vehicle.toml")).cells
    assert [cell.keys.sigma_N_m for cell in cells][:3] == [0.01, 0.01, 0.04]  # type: ignore[union-attr]
    silent.write_text(urdf.read_text().replace('effort="60"', 'effort="much"'))
    assert cli.main([*asked[:-1], str(silent)]) == cli.BAD_INPUT


def test_friction_and_rotors_of_a_free_arm_s_drives_are_in_proportion_to_their_largest_torques(tmp_path: Path) -> None:
    """A drive of 60 N m was stated to lose 0.5: a healthy rehearsal, which draws 1.2, was refused."""
    urdf = Path(__file__).parents[3] / "flight" / "own" / "bench_arm.urdf"  # 60, 60, 40, 15, 15 and 8 N m
    asked = ["init", str(tmp_path), "--base", "free", "--encoder", "cia402", "--urdf", str(urdf)]
    assert cli.main(asked) == cli.OK
    own = tomllib.loads((tmp_path / "vehicle.toml").read_text())["estimation"]["prior"]["absolute"]
    tenth = [0.6, 0.6, 0.4, 0.15, 0.15, 0.1]  # a rotor of 0.1 kg m^2 at every drive: 280 kg with its arm were refused
    for kind, sigmas in (("Fc_", [3.0, 3.0, 2.0, 0.75, 0.75, 0.5]), ("bias_", tenth), ("Ia_", tenth)):
        assert [value for name, value in own.items() if name.startswith(kind)] == sigmas


def test_the_sigma_of_a_torque_of_which_a_free_base_takes_means_over_ticks_is_that_of_a_sample(tmp_path: Path) -> None:
    make(NewVehicle("it", "free", ("shoulder", "elbow"), encoder="cia402"), tmp_path)
    torques = [one.keys.sigma_N_m for one in roles_of(config.load(tmp_path / "vehicle.toml")).cells]  # type: ignore[union-attr]
    assert torques == [0.02, 0.02]


@pytest.mark.parametrize("base", ["fixed", "prescribed"])
def test_links_of_an_arm_scatter_in_rehearsals_as_its_file_says(base: str, tmp_path: Path) -> None:
    make(NewVehicle("it", base, ("shoulder", "elbow"), load_cell="cia404"), tmp_path)  # type: ignore[arg-type]
    identifier, model = build_identifier(config.load(tmp_path / "vehicle.toml"))
    scenario = scenario_of(str(tmp_path / "vehicle.toml"))
    bodies = {
        link: Solid(one.mass_kg, one.centre_of_mass_m, one.inertia_kg_m2)
        for link, one in ((link, body_of(model.chi[10 * k : 10 * k + 10])) for k, link in enumerate(model.links[:3]))
    }
    found = []
    for seed in range(400):
        chi = identifier.model.chi.copy()
        for k, link in enumerate(bodies):
            built = as_built(scenario, bodies, (), np.random.default_rng(seed))[link]
            chi[10 * k : 10 * k + 10] = standard_of(
                RigidBody(built.mass_kg, built.centre_of_mass_m, built.inertia_kg_m2)
            )
        found.append(identifier.base.value(chi))
    told = [name.startswith(("M", "X", "Y", "Z")) and "payload" not in name for name in identifier.base.names]
    sigma = np.sqrt(np.diag(identifier.base.covariance(identifier.taken.prior_root)))[told]
    assert sum(told) == 7
    np.testing.assert_allclose(np.std(np.array(found)[:, told], axis=0), sigma, rtol=0.12)


def test_gains_of_recorded_currents(tmp_path, capsys):
    """They stand in the vehicle file, whose mapping then reads currents."""
    asked = ["init", str(tmp_path / "lab"), "--base", "fixed", "--joints", "2", "--encoder", "recorded"]
    assert cli.main([*asked, "--gains", "12.5,9"]) == cli.OK
    vehicle = config.load(tmp_path / "lab" / "vehicle.toml")
    assert [cell.keys.gain_N_m_A for cell in roles_of(vehicle).cells] == [12.5, 9.0]
    channels = tomllib.loads((tmp_path / "lab" / "import.toml").read_text())["channel"]
    assert {name: one["value"]["unit"] for name, one in channels.items()} == {
        **{"joint_1": "rad", "joint_1_torque": "A", "joint_2": "rad", "joint_2_torque": "A"},
    }
    for wrong, why in (("12.5", "has 1 numbers, the arm 2 joints"), ("1,2,3", "has 3 numbers, the arm 2 joints")):
        assert cli.main([*asked[:1], str(tmp_path / "b"), *asked[2:], "--gains", wrong]) == cli.BAD_INPUT
        assert why in capsys.readouterr().err
    flies = ["init", str(tmp_path / "c"), "--base", "free", "--joints", "2", "--gains", "1,2"]
    assert cli.main(flies) == cli.BAD_INPUT
    assert "--gains is of recorded currents" in capsys.readouterr().err


def test_zeros_of_an_arm_that_is_weighed_by_its_torques_are_as_by_a_mark(tmp_path):
    """0.3 deg, in the file to be corrected; a free base's are estimated within what its prior says."""
    for base, expected in (("fixed", 5e-3), ("free", 1e-3)):
        asked = ["init", str(tmp_path / base), "--base", base, "--joints", "2", "--encoder", "recorded"]
        assert cli.main(asked) == cli.OK
        roles = roles_of(config.load(tmp_path / base / "vehicle.toml"))
        assert [joint.zero_sigma_rad for joint in roles.joints] == [expected] * 2
