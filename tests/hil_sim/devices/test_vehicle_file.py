"""A vehicle file read as a document: every device's emulator, buses, clocks, tolerances, phases; what cannot be."""

import math
import shutil
import tomllib

import pytest

from hil_sim.devices.registry import read as read_devices
from hil_sim.devices.vehicle_file import rehearsal, scenario_of
from hil_sim.mission import Mission, open_in_process
from hil_sim.scenario.tables import ScenarioError
from hil_sim.scenario.vehicle_tables import Tolerance
from onboard import config
from onboard.cli import main
from tests.flight import mixed

SHORT = """
[[sequence]]
phase = 0
action = "hold"
duration_s = 0.2
"""


@pytest.fixture(autouse=True)
def _mujoco_complains_of_nothing(tmp_path, monkeypatch):
    """It writes its warnings to a file in the working directory."""
    monkeypatch.chdir(tmp_path)
    yield
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def copied(directory, name="dymaflex", **changes):
    """A packaged vehicle's file with words exchanged."""
    source = config.packaged(name).parent
    shutil.copytree(source, directory, dirs_exist_ok=True)
    path = directory / "vehicle.toml"
    text = path.read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    return path


def written(directory, text, name="over.toml"):
    path = directory / name
    path.write_text(text)
    return path


def test_every_device_of_a_vehicle_has_its_emulator_on_its_bus(tmp_path):
    scenario = rehearsal(copied(tmp_path))
    devices = read_devices(scenario.device)
    assert devices.keys() == {
        "sync_box",
        "imu_base",
        "imu_2",
        *(f"joint_{n}" for n in range(1, 6)),
        "load_cell",
        "arm_phase",
    }
    assert {devices[f"joint_{n}"].node for n in range(1, 6)} == set(range(1, 6))
    assert devices["imu_2"].address == 0x69
    assert scenario.bus["can_0"].bit_rate == 1_000_000
    assert devices["sync_box"].period_ms == 2.0
    assert scenario.sensor["load_cell"].axis == (1.0, 0.0, 0.0)
    assert scenario.clock["imu_base"].rate_limit == 0.01


def test_the_tolerances_are_those_that_the_file_states(tmp_path):
    path = copied(tmp_path)
    scenario = rehearsal(path)
    said = tomllib.loads(path.read_text())["estimation"]
    for link in ("base", "link_3"):
        own = said["prior"]["link"][link]
        assert scenario.as_built[link].mass_relative == own["mass_relative"]
        assert scenario.as_built[link].centre_mm == pytest.approx(1e3 * own["centre_m"])
    imu, left = scenario.sensor["imu_base"], said["imu_prior"]
    assert imu.gyro_deg_s.bias_sigma[0] == pytest.approx(math.degrees(left["gyro_bias_rad_s"]))
    assert imu.accel_g.scale_sigma == left["accelerometer_scale"]
    assert imu.mounting_sigma_deg == pytest.approx(math.degrees(left["mounting_rad"]))


def test_no_truth_is_what_the_estimator_starts_from_and_each_seed_has_its_own(tmp_path):
    scenario = rehearsal(copied(tmp_path), written(tmp_path, "capture = false\n" + SHORT))
    truths = [Mission(scenario, seed).truth() for seed in (1, 2)]
    for truth in truths:
        assert truth["links"]["base"]["mass_kg"] != 23.1
        assert truth["links"]["link_2"]["centre_of_mass_m"][0] != 0.003
    assert truths[0]["quantities"]["m_payload"] != truths[1]["quantities"]["m_payload"]
    assert truths[0]["posture"] != truths[1]["posture"]
    again = Mission(scenario, 1).truth()
    assert again["quantities"] == truths[0]["quantities"]


def test_a_scenario_file_says_otherwise(tmp_path):
    over = written(
        tmp_path,
        SHORT.replace("0.2", "2.5")
        + "[payload]\nmass_kg = [4.0, 4.0]\n[capture]\nearliest_s = 2.0\nlatest_s = 2.0\n[release]\nrate_rad_s = 0.0\n"
        + "[as_built.default]\nmass_relative = 0.0\n[motion.posture]\njoint_2 = 0.5\n"
        + "[[fault]]\nkind = 'off'\ndevice = 'imu_2'\nstart_s = 1.0\nend_s = 2.0\n",
    )
    mission = Mission(rehearsal(copied(tmp_path), over), 3)
    truth = mission.truth()
    assert truth["quantities"]["m_payload"] == pytest.approx(4.0)
    assert truth["capture_s"] == pytest.approx(2.0, abs=0.01)
    assert truth["posture"]["joint_2"] == 0.5
    assert truth["faults"][0]["device"] == "imu_2"


def test_gravity_release_and_truth_off_the_drawing_are_the_scenario_s(tmp_path):
    exact = "".join(
        f"[as_built.{link}]\nmass_relative = 0.0\ncentre_mm = 0.0\ninertia_relative = 0.0\n"
        for link in ("base", *(f"link_{n}" for n in range(1, 6)))
    )
    spin = "[release]\nrate_rad_s = 0.0\nvelocity_m_s = 0.0\nspin_rad_s = [0.1, -0.2, 0.3]\n"
    over = written(tmp_path, SHORT + "[payload]\nmass_kg = [4.0, 4.0]\n" + spin + exact, "spin.toml")
    path = copied(tmp_path)
    plant = Mission(rehearsal(path, over), 3).plant
    assert math.hypot(*plant.inertial("imu_base").rate_rad_s[0]) == pytest.approx(math.sqrt(0.14))
    as_drawn = plant.truth()["links"]["base"]["mass_kg"]
    assert as_drawn == Mission(rehearsal(path, over), 4).plant.truth()["links"]["base"]["mass_kg"]
    off = Mission(rehearsal(path, _off(over)), 3).plant.truth()["links"]["base"]["mass_kg"]
    assert 0.01 < abs(off / as_drawn - 1.0) < 0.6
    text = path.read_text().replace('base = "free"', 'base = "fixed"')
    path.write_text(text)
    for fall in (9.80665, 1.62):
        moon = written(tmp_path, f"{SHORT}[physics]\ngravity_m_s2 = [0.0, 0.0, {-fall}]\n", "moon.toml")
        felt = Mission(rehearsal(path, moon), 3).plant.inertial("imu_base").specific_force_m_s2
        assert math.hypot(*felt[10]) == pytest.approx(fall)


def _off(over):
    text = over.read_text().replace("[as_built.base]\nmass_relative = 0.0", "[as_built.base]\nmass_relative = 0.2")
    return written(over.parent, text, "off.toml")


def test_a_capture_is_at_the_time_or_the_phase_that_the_scenario_file_states(tmp_path):
    path = copied(tmp_path, "workshop")
    assert rehearsal(path).capture.phase == 2
    timed = rehearsal(path, written(tmp_path, "[capture]\nearliest_s = 9.0\nlatest_s = 9.0\n")).capture
    assert (timed.phase, timed.earliest_s, timed.latest_s) == (None, 9.0, 9.0)
    assert timed.velocity_sigma_m_s == 0.0
    other = written(tmp_path, "[capture]\nphase = 1\n", "other.toml")
    assert rehearsal(path, other).capture.phase == 1


def test_a_vehicle_that_is_zeroed_in_free_fall_coasts(tmp_path):
    motion = rehearsal(copied(tmp_path, "rocksat")).base_motion
    assert (motion.acceleration_m_s2, motion.rate_rad_s, motion.still_s) == (0.0, 0.02, 4.0)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.campaign) for seed in (1, 2))])
def test_joints_stay_within_the_limits_of_the_urdf(tmp_path, seed):
    path = copied(tmp_path)
    urdf = tmp_path / "dymaflex.urdf"
    urdf.write_text(
        urdf.read_text().replace(
            'lower="-3.1" upper="3.1" effort="20" velocity="3"', 'lower="0.2" upper="0.5" effort="20" velocity="0.1"'
        )
    )
    plant = Mission(rehearsal(path), seed).plant
    q, dq = plant.rows_true.joints, plant.rows_true.rates
    assert q.min() > 0.2
    assert q.max() < 0.5
    assert abs(dq).max() < 0.1
    assert (q.max(axis=0) - q.min(axis=0)).min() > 0.02


@pytest.mark.parametrize("third", ["joint_3", "joint [3].é, q'"])
def test_motion_from_a_csv(tmp_path, third):
    path = copied(tmp_path, **{'joint = "joint_3"': f'joint = "{third}"', "\njoint_3 = {": f'\n"{third}" = {{'})
    urdf = tmp_path / "dymaflex.urdf"
    urdf.write_text(urdf.read_text().replace('"joint_3"', f'"{third}"'), encoding="utf-8")
    rows = ["time_s," + ",".join(f"joint_{n}" for n in range(1, 6)).replace("joint_3", f'"{third}"')]
    rows += [f"{t / 10},{','.join(str(0.1 * n * (t / 10) ** 2 / 10) for n in range(1, 6))}" for t in range(20)]
    written(tmp_path, "\n".join(rows), "motion.csv")
    over = written(tmp_path, 'capture = false\n[motion]\ncsv = "motion.csv"\n' + SHORT.replace("0.2", "2.5"))
    plant = Mission(rehearsal(path, over), 1).plant
    at = round(1.0 / plant.step_s)
    assert plant.rows_true.joints[at, 2] == pytest.approx(0.03, abs=1e-4)
    assert plant.rows_true.joints[-1, 2] == pytest.approx(0.3 * 1.9**2 / 10, abs=1e-6)
    assert plant.rows_true.rates[-1, 2] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("[payload]\nmass_kg = [-1.0, 2.0]", "payload.mass_kg"),
        ("[vehicle]\nbase = 'fixed'", "vehicle file's"),
        ("[motion.posture]\nelbow = 1.0\n" + SHORT, "elbow"),
        ("[motion.posture]\njoint_1 = 9.0\n" + SHORT, "goes from"),
        ("[motion]\ncsv = 'none.csv'\n" + SHORT, "cannot be read"),
        ("[as_built.nose]\nmass_relative = 0.1\n" + SHORT, "nose"),
        ("[as_built.base]\ninertia_relative = 50.0\n" + SHORT, "hardly any body"),
        ("[capture]\nearliest_s = 500.0\nlatest_s = 600.0", "capture must lie"),
        ("[capture]\nphase = 7", "no \\[\\[sequence\\]\\] has phase 7; there are 0, 1, 2, 9"),
        ("[capture]\nphase = 1\nlatest_s = 6.0", "phase and latest_s: give either"),
        ("[lost_part]\nat_s = 5.0\nmass_kg = 1000.0", "no body is left of the payload"),
        ("[gravity]\nx = 1", "gravity"),
        ("not toml", "not TOML"),
    ],
)
def test_a_scenario_that_cannot_be_is_refused_with_the_key(tmp_path, text, wrong):
    with pytest.raises(ScenarioError, match=wrong):
        Mission(rehearsal(copied(tmp_path), written(tmp_path, text)), 1)


@pytest.mark.parametrize(
    ("old", "new", "wrong"),
    [
        ('kind = "mpu6050"', 'kind = "recorded_imu"', "cannot be rehearsed"),
        ('kind = "mpu6050"', 'kind = "wind_vane"', "wind_vane"),
        ('joint = "joint_3"', 'joint = "knee"', "knee"),
        ('frame = "imu_2"', 'frame = "nowhere"', "nowhere"),
        ("index = 0x2000", "index = 0x2001", "2000h:1"),
        ('urdf = "dymaflex.urdf"', 'urdf = "other.urdf"', "cannot be read"),
        ('base_link = "base"', 'base_link = "link_1"', "hangs on"),
        ("node = 1\n", "", "'node' is missing|device.joint_1.node"),
    ],
)
def test_a_vehicle_that_cannot_be_rehearsed_says_why(tmp_path, old, new, wrong):
    over = written(tmp_path, "capture = false\n" + SHORT)
    with pytest.raises(ScenarioError, match=wrong):
        Mission(rehearsal(copied(tmp_path, **{old: new}), over), 1)


def test_every_kind_of_device_with_a_bus_has_an_emulator(tmp_path):
    """The vehicle with all kinds, without what is the flight computer's own and channels that cannot be rehearsed."""
    table = tomllib.loads(mixed.DEVICES)
    text = mixed.DEVICES
    for name in ("loop", "second"):
        text = text[: text.index(f"[device.{name}]")] + text[text.index("[", text.index(f"[device.{name}]") + 1) :]
    for axis in "xyz":
        for role in ("gyro", "accel"):
            part = f'[[device.wrist.channel]]\nname = "{role}_{axis}"'
            at = text.index(part)
            text = text[:at] + text[text.index("\n[", at) + 1 :]
    text = text.replace('rate_hz = 200\nframe = "link_4"\n', "rate_hz = 200\n")
    text = text[: text.index("[device.phase]")] + text[text.index("[[", text.index("[device.phase]")) - 0 :]
    (tmp_path / "mixed.urdf").write_text(mixed.urdf())
    path = written(
        tmp_path, text.replace("[[device.wrist.channel]]", _WRIST + "[[device.wrist.channel]]", 1), "vehicle.toml"
    )
    scenario = scenario_of(path, written(tmp_path, SHORT))
    kinds = {device.kind for device in read_devices(scenario.device).values()}
    assert len(table["device"]) > 10
    assert {
        "mpu6050",
        "nimu",
        "encoder406",
        "drive402",
        "qsb",
        "loadcell404",
        "modbus_load_cell",
        "dsc_load_cell",
        "node_frame",
    } <= kinds
    mission, urls = open_in_process(scenario, 1)
    with mission:
        mission.advance(mission.start_ns + 100_000_000)
    assert urls.keys() == scenario.bus.keys()


_WRIST = """
[device.wrist]
kind = "node_frame"
bus = "tty_node"
node = 7
tick_hz = 1000000
rate_hz = 200

"""


def test_a_payload_that_the_urdf_draws_is_let_go_with_all_its_mass(tmp_path):
    """RockSat's tip mass: its drawing's shape at another density, and gone from the arm after the ejection."""
    plant = Mission(rehearsal(copied(tmp_path, "rocksat")), 1).plant
    truth = plant.truth()
    drawn_kg, mass_kg = 0.06627, truth["quantities"]["m_tip_mass"]
    assert drawn_kg / 1.25 < mass_kg < drawn_kg * 1.25
    assert mass_kg != drawn_kg
    assert "tip_mass" not in truth["links"]
    assert truth["ejection_s"] > 0.0
    assert plant.flight.model.body("l.tip_mass").mass[0] == 0.0


def test_joints_imus_and_zeros_are_off_the_drawing_as_stated_or_by_a_default(tmp_path):
    joint_1 = "joint_1 = { position_m = 5e-4, zero_rad = 1e-3, scale = 2e-4, delay_s = 2e-4 }"
    joint_2 = joint_1.replace("joint_1", "joint_2")
    path = copied(tmp_path, **{joint_1: "joint_1 = { position_m = 7e-4, zero_rad = 2e-3 }", joint_2: ""})
    scenario = rehearsal(path)
    places = {name: table.place_mm for name, table in scenario.as_built.items() if table.place_mm}
    links = {f"link_{n}": 0.5 for n in range(2, 6)}
    assert places == pytest.approx({"link_1": 0.7, **links, "imu_base": 3.0, "imu_2": 3.0})
    assert scenario.as_built["link_1"].mass_relative == 0.03  # as the file states of the link
    assert [scenario.sensor[f"joint_{n}"].zero_sigma_mrad for n in (1, 2, 3)] == [2.0, 1.0, 1.0]
    assert all(not table.place_mm for table in rehearsal(copied(tmp_path / "fixed", "fixed_arm")).as_built.values())


@pytest.mark.parametrize(("stated", "drawn"), [(0.02, 0.02), (0.1, 0.1), (1.0, 0.01)])
def test_a_link_whose_drawing_is_trusted_is_within_what_is_stated_of_it(tmp_path, stated, drawn):
    main(["init", str(tmp_path / "own"), "--base", "fixed", "--joints", "2", "--load-cell", "cia404"])
    path = tmp_path / "own" / "vehicle.toml"
    text = path.read_text()
    as_made = '"link_1" = { mass_relative = 0.02, centre_m = 2e-3, inertia_relative = 0.02 }\n'
    assert as_made in text
    assert 'row_noise = "by_frequency"' in text
    relative = text.replace(as_made, "").replace('"payload" = 1.0\n', f'"payload" = 1.0\n"link_1" = {stated}\n')
    path.write_text(relative)
    scenario = rehearsal(path)
    tolerance = scenario.as_built.get("link_1", Tolerance())
    assert (tolerance.mass_relative, tolerance.inertia_relative) == (drawn, drawn)
    assert tolerance.centre_mm == pytest.approx(100.0 * drawn)
    cell = scenario.sensor["load_cell"]
    assert (cell.delay_ms, cell.delay_sigma_ms) == (0.5, 0.05)
