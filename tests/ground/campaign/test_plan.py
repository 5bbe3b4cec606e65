"""plan.toml: what is refused, and with which words; what a design comes to; what names a result."""

import importlib
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from onboard import cli, config
from onboard.ground.campaign import plan_file
from onboard.ground.campaign.design import Item, items
from onboard.ground.campaign.revision import revision

ROOT = Path(__file__).parents[3]
HEAD = '[campaign]\nname = "x"\n'
ROCKET = HEAD + '[flight]\nmission = "rocksat"\n'


def read(tmp_path: Path, text: str) -> list[Item]:
    path = tmp_path / "plan.toml"
    path.write_text(text)
    return items(plan_file.read(path))


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        (HEAD + "seed = 3\n", 3, "unknown key 'campaign.seed'; did you mean 'seeds'"),
        (HEAD + "seeds = 0\n" + ROCKET[len(HEAD) :], 3, "1 or more"),
        (HEAD + 'seeds = "5"\n' + ROCKET[len(HEAD) :], 3, "written|number"),
        (HEAD, 1, "'flight' is missing"),
        (HEAD + "[flight]\n", 3, "give mission, logs or call; there is none"),
        (ROCKET + 'call = "a:b"\n', 3, "there is mission and call"),
        (HEAD + '[flight]\ncall = "os.system"\n', 4, "pattern"),
        (ROCKET + "[factor.a]\nvalues = [1]\n", 5, "need a key"),
        (ROCKET + '[factor.a]\nkey = "mass"\nvalues = [1]\n', 5, "key is scenario.TABLE.KEY"),
        (ROCKET + '[factor.a]\nkey = "scenario.x.y"\nrange = [2, 1]\n', 5, "lowest number, then the highest"),
        (ROCKET + '[factor.a]\nkey = "scenario.x.y"\nrange = [1, 2]\n', 1, "a grid needs the steps"),
        (ROCKET + '[factor.a.level.b]\nfault = ["off:imu_base:1:2"]\n', 6, "did you mean 'faults'"),
        (ROCKET + "[settings]\nx = 1\n", 1, "a plan of mission has no settings"),
        (ROCKET + "[faults]\ncount = [1.0]\nstart_s = [1, 2]\nkinds = {}\n", 1, "design = 'random'"),
    ],
)
def test_a_plan_that_cannot_be_is_refused_with_its_line(tmp_path: Path, text: str, line: int, said: str) -> None:
    with pytest.raises(config.ConfigError) as caught:
        read(tmp_path, text)
    first = str(caught.value).splitlines()[0]
    assert first.startswith(f"{tmp_path}/plan.toml:{line}: "), first
    assert any(words in str(caught.value) for words in said.split("|")), str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[flight]\nmission = "roksat"\n', "did you mean 'rocksat'"),
        ('[flight]\nmission = "rocksat"\n[scenario.bod]\nx = 1\n', "bod"),
        ('[flight]\nmission = "rocksat"\nfaults = ["off:imu_bas:1:2"]\n', "imu_bas"),
        ('[flight]\nmission = "rocksat"\n[vehicle.estimation]\nrow_rat_hz = 1\n', "did you mean 'row_rate_hz'"),
        ('[flight]\nmission = "none.toml"\n', "give the path of a vehicle.toml"),
        ('[flight]\nlogs = "."\n', "there is no log below"),
    ],
)
def test_what_cannot_fly_is_refused_before_anything_flies(
    tmp_path: Path, text: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(HEAD + text)
    assert cli.main(["campaign", str(plan), "-o", str(tmp_path / "out")]) == cli.BAD_INPUT
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


GRID = (
    HEAD
    + """seeds = 3
first_seed = 10
[flight]
mission = "rocksat"
faults = ["reset:imu_base:1:2"]
[scenario.sensor.imu]
temperature_rise_K = 1.0
[factor.rise]
key = "scenario.sensor.imu.temperature_rise_K"
range = [1.0, 100.0]
steps = 3
scale = "log"
[factor.cell.level.good]
[factor.cell.level.stuck]
faults = ["stuck:load_cell:3"]
vehicle.estimation.row_rate_hz = 50.0
"""
)


def test_a_grid_is_every_level_with_every_seed(tmp_path: Path) -> None:
    found = read(tmp_path, GRID)
    assert len(found) == 3 * 2 * 3
    assert [item.seed for item in found[:3]] == [10, 11, 12]
    rises = [item.scenario["sensor"]["imu"]["temperature_rise_K"] for item in found[::6]]
    np.testing.assert_allclose(rises, [1.0, 10.0, 100.0])
    stuck = found[3]
    assert stuck.point == {"rise": 1.0, "cell": "stuck"}
    assert stuck.faults == ("reset:imu_base:1:2", "stuck:load_cell:3")
    assert stuck.vehicle == {"estimation": {"row_rate_hz": 50.0}}
    assert len({item.address("r") for item in found}) == 18


def test_other_seeds_are_taken_in_place_of_the_plans(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(ROCKET)
    assert [item.seed for item in items(plan_file.read(path, first_seed=7, seeds=2))] == [7, 8]
    with pytest.raises(config.ConfigError, match="1 or more"):
        plan_file.read(path, seeds=0)


RANDOM = """design = "random"
[flight]
mission = "rocksat"
[factor.which]
level.a.weight = 3.0
level.b.scenario.sensor.imu.temperature_rise_K = 5.0
[faults]
count = [0.25, 0.5, 0.25]
start_s = [2.0, 10.0]
length_s = [1.0, 2.0]
staying = 0.5
[faults.kinds.rocksat]
imu_base = ["off", "wrong:-0.5"]
load_cell = ["stuck"]
joint_1 = ["silent"]
"""


def test_a_random_design_is_drawn_from_each_seed_alone(tmp_path: Path) -> None:
    few, many = (read(tmp_path, f"{HEAD}seeds = {count}\n{RANDOM}") for count in (50, 400))
    assert many[:50] == few
    counts = np.bincount([len(item.faults) for item in many]) / 400
    np.testing.assert_allclose(counts, [0.25, 0.5, 0.25], atol=0.08)
    assert 0.67 < np.mean([item.point["which"] == "a" for item in many]) < 0.83
    assert all(len({fault.split(":")[1] for fault in item.faults}) == len(item.faults) for item in many)
    stays = [fault.split(":")[3] == "" for item in many for fault in item.faults]
    assert 0.4 < np.mean(stays) < 0.6
    for fault in (fault for item in many for fault in item.faults):
        _, _, start, end, *value = fault.split(":")
        assert 2.0 <= float(start) <= 10.0
        assert not end or 1.0 <= round(float(end) - float(start), 3) <= 2.0
        assert value == (["-0.5"] if fault.startswith("wrong") else [])


def test_the_plan_of_the_docs_is_one(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "campaigns.md").read_text(encoding="utf-8")
    (plan,) = re.findall(r"^```toml\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert len(read(tmp_path, plan)) == 80


@pytest.mark.parametrize("path", sorted((ROOT / "bench" / "plans").glob("*.toml")), ids=lambda path: path.stem)
def test_the_plans_of_the_bench_can_be_read(path: Path) -> None:
    plan = plan_file.read(path)
    found = items(plan)
    assert len({item.address("r") for item in found}) == len(found)
    if plan.file.flight.call:
        module, _, function = plan.file.flight.call.partition(":")
        assert callable(getattr(importlib.import_module(module), function))


def test_logs_below_a_folder_are_found_by_flight(tmp_path: Path) -> None:
    (tmp_path / "flights" / "deep").mkdir(parents=True)
    for name, data in (("flights/a.mcap", b"1"), ("flights/deep/b.mcap", b"2"), ("flights/c.txt", b"3")):
        (tmp_path / name).write_bytes(data)
    text = HEAD + '[flight]\nlogs = "flights"\nvehicle = "workshop"\n'
    text += '[factor.rate]\nkey = "vehicle.estimation.row_rate_hz"\nvalues = [50.0, 100.0]\n'
    found = read(tmp_path, text)
    assert [(Path(one.log).name, one.point["rate"]) for one in found] == [
        *(("a.mcap", rate) for rate in (50.0, 100.0)),
        *(("b.mcap", rate) for rate in (50.0, 100.0)),
    ]
    before = found[0].address("r")
    (tmp_path / "flights/a.mcap").write_bytes(b"4")
    assert read(tmp_path, text)[0].address("r") != before


def test_the_name_of_a_result_changes_with_everything_that_it_depends_on() -> None:
    item = Item(3, {"a": "b"}, "rocksat", faults=("off:imu_base:1:2",), files={"x": "text"})
    others = [
        replace(item, seed=4),
        replace(item, mission="dymaflex"),
        replace(item, faults=()),
        replace(item, scenario={"a": 1}),
        replace(item, vehicle={"a": 1}),
        replace(item, files={"x": "other"}),
        replace(item, point={"a": "c"}),
    ]
    names = {one.address("r") for one in (item, *others)} | {item.address("s")}
    assert len(names) == len(others) + 2
    assert replace(item, keep="all").address("r") == item.address("r")


def test_the_revision_is_of_code_that_can_change_an_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("onboard/flight/a.py", "onboard/cli/b.py", "drivers/c.py", "hil_sim/d.toml"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1\n")
    monkeypatch.setattr("onboard.ground.campaign.revision._ROOT", tmp_path)

    def now() -> str:
        revision.cache_clear()
        return revision()

    before = now()
    (tmp_path / "onboard/cli/b.py").write_text("2\n")
    assert now() == before
    (tmp_path / "hil_sim/d.toml").write_text("2\n")
    assert now() != before
    revision.cache_clear()
