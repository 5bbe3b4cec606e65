"""Bad vehicle files: the line, the reason, the remedy."""

import random
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from onboard import config
from onboard.flight.estimate.estimator import Estimator

TEXT = config.packaged("rocksat").read_text()
MIXED = (Path(__file__).parents[1] / "flight" / "mixed.toml").read_text(encoding="utf-8")


def refuse(old: str, new: str) -> str:
    assert TEXT.count(old) >= 1
    with pytest.raises(config.ConfigError) as caught:
        config.parse(TEXT.replace(old, new, 1), config.packaged("rocksat"))
    return str(caught.value)


def refuse_mixed(old: str, new: str) -> str:
    """What is said of the vehicle with a device of every kind, its URDF aside, and that it names a line."""
    assert MIXED.count(old) >= 1, old
    with pytest.raises(config.ConfigError) as caught:
        config.parse(MIXED.replace(old, new, 1), Path("mixed/vehicle.toml"))
    said = str(caught.value)
    assert re.match(r"mixed/vehicle\.toml:[1-9][0-9]*: ", said)
    return said


def line_of(text: str, start: str) -> int:
    return next(n for n, line in enumerate(text.splitlines(), 1) if line.startswith(start))


def test_the_packaged_vehicle_reads() -> None:
    vehicle = config.load(config.packaged("rocksat"))
    assert list(vehicle.devices_on("can_0")) == ["can_sync", "joint_1", "load_cell", "arm_phase"]
    assert vehicle.urdf_path.is_file()


def test_an_unknown_key_names_line_and_the_key_meant() -> None:
    message = refuse("poll_period_ms = 10", "poll_period_s = 0.01")
    assert f"vehicle.toml:{line_of(TEXT, 'poll_period_ms')}:" in message
    assert "'device.imu_base.poll_period_s'" in message
    assert "did you mean 'poll_period_ms'" in message


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('bus = "i2c_1"', 'bus = "i2c_9"', "no bus 'i2c_9'; there are: i2c_1, can_0, sync_line"),
        ("address = 0x68", "address = 0x10", "104 or more is wanted here (given: 16)"),
        ('kind = "mpu6050"', 'kind = "mpu9999"', "is none of as5048a, as5048b"),
        (
            'kind = "mpu6050"',
            'kind = "wind_vane"',
            "; a kind of another package is known where",
        ),
        ("node = 2\n", "", "'device.load_cell.node' is missing"),
        ("[estimation.gates]", "[estimation.gate]", "did you mean 'gates'"),
        (
            'channel = "arm_phase"',
            'channel = "phase"',
            "no channel 'phase' with values; there are: joint_1, load_cell, arm_phase",
        ),
        ('urdf = "rocksat.urdf"', 'urdf = "lost.urdf"', "put the URDF beside the vehicle file"),
        ("[vehicle]", "[vehicle", "not TOML"),
        ('base = "prescribed"', 'base = "floating"', "none of free, prescribed, fixed, planar"),
        ("lever_m = 0.040", "lever_mm = 40", "did you mean 'lever_m'"),
        ("step_ms = 100", 'method = "instrumental"\nstep_ms = 100', "none of rows, exiddm"),
        ("step_ms = 100", 'smoothing = "kalman"\nstep_ms = 100', "none of spline, smoother"),
        (
            "[estimation.gates]",
            "[estimation.memory]\nwindow_s = 9\n[estimation.gates]",
            "unknown key 'estimation.memory'",
        ),
        *(
            (
                "step_ms = 100",
                f'scales = "{word}"\nstep_ms = 100',
                "'estimation.scales' is gone, as errors of",
            )
            for word in ("considered", "estimated")
        ),
    ],
)
def test_other_mistakes(old: str, new: str, expected: str) -> None:
    assert expected in refuse(old, new)


def without(device: str) -> str:
    start = TEXT.index(f"[device.{device}]")
    return TEXT[start : TEXT.index("[device.", start + 1)]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (without("imu_base"), "", "no device is an IMU"),
        (without("can_sync"), "", "bus 'can_0' has 0 canopen_sync devices; it needs exactly one"),
        ('bus = "i2c_1"', 'bus = "can_0"', "bus 'can_0' has devices of CAN and I2C"),
    ],
)
def test_devices_that_cannot_fly_together(old: str, new: str, expected: str) -> None:
    assert expected in refuse(old, new)


NODE_GYRO = '[[device.wrist.channel]]\nname = "gyro_x"\nrole = "gyro"\naxis = "x"\nnoise_rad_s = 1e-3\n'


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        # buses
        ('url = "serial:///dev/ttyUSB0?baud=115200"', 'url = "i2c:///dev/i2c-2"', "are on a serial line: bus URL"),
        ("?baud=115200", "", "lacks baud: add '?baud=...'"),
        ("?line=17", "", "lacks line: add '?line=...'"),
        ("?baud=115200", "?baud=115200&parity_bit=N", "unknown options parity_bit"),
        (
            'bus = "tty_grip"',
            'bus = "tty_cell"',
            "'tty_cell' has cell, grip; a serial line has a single device: give each",
        ),
        ('bus = "loop_in"', 'bus = "sync_line"', "'sync_line' has pulse, second; a pulse line has a single device"),
        ('bus = "tty_imu"', 'bus = "tty_9"', "no bus 'tty_9'; there are: i2c_1, can_0"),
        # CAN
        ("node = 4", "node = 1", "'upper' and 'shoulder' are both node 1; set the same profile"),
        (
            "node = 3",
            'node = 1\nsupervision = "guarding"',
            "'phase' and 'shoulder' are the same node; give both the same",
        ),
        ("node = 3", 'node = 3\nsupervision = "guarding"\nguard_time_ms = 0', "guard_time_ms = 0: use 1..65535"),
        ("node = 3", 'node = 3\nsupervision = "watching"', "none of heartbeat, guarding"),
        ("torque = true", "torque = true\ntpdos = [1]", "its values fill 2 TPDOs: name more tpdos"),
        ("torque = true", "torque = true\ngear_ratio = 0", "gear_ratio = 0.0: motor revolutions"),
        ('format = "u8"', 'format = "u64"\nbyte_offset = 4', "byte_offset = 4: the object must end in 8 bytes"),
        ('kind = "canopen_sync"', 'kind = "canopen_sync"\nnode = 9', "unknown key 'device.can_sync.node'"),
        # drivers refuse what does not go together
        ("noise_rad_s = 1.95e-3", "noise_rad_s = 1.95e-3\nsample_rate_hz = 300", "use a whole fraction of 1000"),
        ("noise_rad_s = 1.95e-3", "noise_rad_s = 1.95e-3\npoll_period_ms = 50", "over 36 samples would gather"),
        ("noise_rad_s = 1.95e-3", 'noise_rad_s = 1.95e-3\nmode = "stream"', "none of fifo, burst"),
        ('unit = "N"\n', "", "scale and unit go together"),
        ("sample_period_ms = 20", "sample_period_ms = 20\ntimeout_ms = 10", "the manual allows an answer 50 ms"),
        ("sample_period_ms = 10", "sample_period_ms = 10\naddress = 300", "247 or less"),
        ("sample_period_ms = 10", 'sample_period_ms = 10\nvalues = ["tare"]', "none of gross, net"),
        ('bus = "tty_joint"', 'bus = "tty_joint"\ninterval_ticks = 0', "interval_ticks = 0: use 1 to"),
        ('bus = "tty_joint"', 'bus = "tty_joint"\nsync_edge = "both"', "none of rising, falling, none"),
        ("sample_rate_hz = 150", "", "'device.imu_tip.sample_rate_hz' is missing; add it"),
        ("sample_rate_hz = 150", 'sample_rate_hz = 150\nchecksum_span = "all"', "none of packet, after_sync, payload"),
        # a node's channels
        ('role = "record"', 'role = "recorded"', "none of record, joint, force, gyro, accel; did you mean 'record'?"),
        ("noise_rad = 1e-6", "noise_deg = 1e-6", "did you mean 'noise_rad'"),
        ('name = "mode"', 'name = "angle"', "name each channel of the node, once"),
        (NODE_GYRO, "", "'wrist' is an IMU by parts; give gyro x, y, z and accel x, y, z, each once"),
        ('role = "gyro"\naxis = "x"', 'role = "gyro"\naxis = "y"', "'wrist' is an IMU by parts"),
        ('frame = "link_4"\n\n[[', "\n[[", "'wrist' has gyro and accel channels; give the frame"),
        # pulses
        (
            "[device.loop]",
            '[device.other]\nkind = "sync_pulse"\nbus = "loop_in"\nsync_period_ms = 5\n[device.loop]',
            "'loop_in' has",
        ),
        ('bus = "loop_out"', 'bus = "loop_out"\nsync_bus = "tty_imu"', "no CAN bus 'tty_imu' with devices"),
        (
            '"loop_out"\nsync_period_ms = 5',
            '"loop_out"\nsync_period_ms = 4\nsync_bus = "can_0"',
            "has period_ms = 5; give",
        ),
        ('"loop_out"\nsync_period_ms = 5', '"loop_out"\nsync_period_ms = 1', "give more than the dither of 1 ms"),
        # channels
        ("[device.second]", "[device.elbow_mark]", "channel 'elbow_mark' is that of 'elbow' too; rename either"),
        ("[device.second]", "[device.event]", "channel 'event' is heft's"),
        ("[device.second]", '[device."1pps"]', "channel '1pps' is not a name; use a letter, then letters"),
        ("[device.second]", "[device.second_pulse_of_the_receiver_on_top]", "32 at the most"),
        ('channel = "wrist_mode"', 'channel = "wrist"', "no channel 'wrist' with values; there are: imu_tip_mag_x"),
        ('channel = "wrist_mode"', 'channel = "pulse"', "no channel 'pulse' with values"),
    ],
)
def test_devices_that_do_not_go_together(old: str, new: str, expected: str) -> None:
    assert expected in refuse_mixed(old, new)


def test_the_line_of_a_nodes_channel_is_named() -> None:
    line = line_of(MIXED, "noise_m_s2")
    said = refuse_mixed("\nnoise_m_s2 = 0.01", "\nnoise_m_s = 0.01")
    assert f":{line}: unknown key 'device.wrist.channel.5.noise_m_s'; did you mean 'noise_m_s2'" in said


def test_an_slcan_adapter_cannot_be_opened_twice() -> None:
    text = MIXED.replace("can+socketcan://can0?bitrate=500000", "can+slcan:///dev/ttyACM0?bitrate=500000")
    text = text.replace('bus = "loop_out"', 'bus = "loop_out"\nsync_bus = "can_0"')
    with pytest.raises(config.ConfigError, match=r"can be opened once.*use can\+socketcan"):
        config.parse(text, Path("mixed/vehicle.toml"))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            'frame = "imu_base"',
            'frame = "nose"',
            "vehicle.toml:\\d+: frame 'nose' is not in the URDF; its links are plate",
        ),
        (
            'joint = "joint_1"\ncounts',
            'joint = "elbow"\ncounts',
            "vehicle.toml:\\d+: joint 'elbow' is not in the URDF; its moving joints are joint_1",
        ),
        ("arm = 1.0, ", "", "\\[estimation.prior\\]: .*none is given of arm: give each"),
    ],
)
def test_names_that_the_urdf_does_not_have_are_refused_before_the_flight(old: str, new: str, expected: str) -> None:
    assert old in TEXT
    with pytest.raises(config.ConfigError, match=expected):
        Estimator(config.parse(TEXT.replace(old, new, 1), config.packaged("rocksat")))


@pytest.mark.parametrize(("payload", "refused"), [("1.0", True), ("0.0", False)])
def test_a_share_of_nothing_is_not_taken_for_exact(payload: str, refused: bool) -> None:
    """The payload link has no inertia in the URDF: nobody may take it for a known nothing without saying so."""
    path = config.packaged("dymaflex_parabolic")
    links = ", ".join(f"link_{k} = 0.0" for k in range(1, 6))
    rows = '[estimation]\nbase_rows = ["force", "moment"]'
    prior = f"[estimation.prior]\nrelative = {{ base = 0.01, {links}, payload = {payload} }}"
    devices, _, _ = path.read_text().partition("[estimation]")
    vehicle = config.parse(f"{devices}\n{rows}\n{prior}\n", path)
    if refused:
        with pytest.raises(config.ConfigError, match=r"'payload' has no mass.*M_payload to ZZ_payload"):
            Estimator(vehicle)
    else:
        names = Estimator(vehicle).identifier.parameter_names
        assert names
        assert all(name.removesuffix("_R").endswith("_base") for name in names)


@pytest.mark.parametrize(
    ("vehicle", "header", "key", "named", "meant"),
    [
        ("dymaflex", "[estimation.exiddm]", "false_alarms_per_h", "estimation.exiddm", "false_alarms_per_hour"),
        ("dymaflex", "[estimation.imu_prior]", "gyro_bias_deg_s", "estimation.imu_prior", "gyro_bias_rad_s"),
        ("dymaflex", "[estimation.prior.link.base]", "mass_relativ", "estimation.prior.link.base", "mass_relative"),
        ("dymaflex_air_bearing", "[planar]", "tilt_sigma_m_s", "planar", "tilt_sigma_m_s2"),
        ("dymaflex_air_bearing", "[[planar.puck]]", "coulomb_N", "planar.puck.0", "coulomb_sigma_N"),
        ("tudelft", "[free_body]", "rotor", "free_body", "rotor_sigma"),
        ("tudelft", "[free_body.carrier]", "inertia_sigma", "free_body.carrier", "inertia_sigma_kg_m2"),
        ("tudelft", "[[free_body.load]]", "bars_percnt", "free_body.load.0", "bars_percent"),
    ],
)
def test_the_key_meant_is_found_in_every_table(vehicle: str, header: str, key: str, named: str, meant: str) -> None:
    path = config.packaged(vehicle)
    text = path.read_text()
    lines = text.splitlines()
    place = next(n for n, line in enumerate(lines) if line.startswith(header))
    lines.insert(place + 1, f"{key} = 1")
    with pytest.raises(config.ConfigError) as caught:
        config.parse("\n".join(lines), path)
    said = str(caught.value)
    assert f"vehicle.toml:{place + 2}: unknown key '{named}.{key}'; did you mean {meant!r}? Units are in" in said


def test_a_missing_file_says_so(tmp_path: Path) -> None:
    with pytest.raises(config.ConfigError, match=r"No such file.*give the path of a vehicle\.toml"):
        config.load(tmp_path / "nowhere.toml")


def test_a_urdf_in_place_of_a_vehicle_file_says_what_makes_one() -> None:
    with pytest.raises(config.ConfigError, match=r"arm\.urdf is a URDF, .* heft init --urdf arm\.urdf DIRECTORY makes"):
        config.named("arm.urdf")


def test_urls_can_be_replaced_and_nothing_else_changes() -> None:
    vehicle = config.load(config.packaged("rocksat"))
    other = vehicle.with_urls({"can_0": "can+virtual://x"})
    assert other.file.bus["can_0"].url == "can+virtual://x"
    assert other.file.bus["i2c_1"] == vehicle.file.bus["i2c_1"]
    assert other.file.device == vehicle.file.device


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("joint_limits_deg = [-13.0, 13.0]", "joint_limits_deg = [13, -13]", "write the lower limit first"),
        ("joint_limits_deg = [-13.0, 13.0]", "joint_limits_deg = [nan, 13]", "finite number"),
        ("step_ms = 100", "step_ms = 1e-300", "1 or more is wanted"),
        ("lag_ms = 300", "lag_ms = inf", "finite number"),
        ("lag_ms = 300", "lag_ms = 9e9", "5000 or less is wanted"),
        ("lag_ms = 300", "lag_ms = 120", "ends 125 ms after its row, so no row would be made; write 187.5"),
        ("zero_count = 1000000", "zero_count = 99999999999999999999", "4294967296 or less is wanted"),
        ("counts_per_revolution = 500000", "counts_per_revolution = 4294967296", "4294967295 or less is wanted"),
        ("row_rate_hz = 100", "row_rate_hz = true", "a number is wanted here (given: true)"),
        ("row_rate_hz = 100", 'row_rate_hz = "100"', "write it without quotes"),
        ("[device.load_cell]", "[device.recorder_gap]", "is heft's"),
        ("[device.load_cell]", "[device.health]", "is heft's"),
        ('urdf = "rocksat.urdf"', 'urdf = "../rocksat.urdf"', "put the URDF beside the vehicle file"),
        ('name = "rocksat"', 'name = "../../tmp/x"', "is to name files"),
        ('kind = "mpu6050"', "kind = []", "kind"),
    ],
)
def test_what_would_be_fatal_in_flight_is_refused_with_its_line(old: str, new: str, expected: str) -> None:
    message = refuse(old, new)
    assert expected in message
    assert re.search(r"vehicle\.toml:[1-9][0-9]*: ", message)


def test_rows_wait_until_a_wide_kernel_is_full(tmp_path: Path) -> None:
    """With 200 ms in any case, nothing was estimated with 600 ms and nobody was told."""
    text = config.packaged("dymaflex").read_text(encoding="utf-8")
    shutil.copytree(config.packaged("dymaflex").parent, tmp_path, dirs_exist_ok=True)
    for width_ms, lag_ms in ((250, 200.0), (600, 450.0)):
        changed = re.sub(r"(?m)^lag_ms = .*$", "", text.replace("smoothing_ms = 250", f"smoothing_ms = {width_ms}"))
        (tmp_path / "vehicle.toml").write_text(changed, encoding="utf-8")
        assert config.load(tmp_path / "vehicle.toml").file.estimation.lag_ms == lag_ms


TOKEN = re.compile(r'"[^"]*"|-?\b\d[\d_]*(?:\.\d+)?(?:[eE][-+]?\d+)?\b|\btrue\b|\bfalse\b')
EXTREMES = ("0", "-1", "1e-300", "1e300", "inf", "nan", "true", '"5"', "[]", "{}", "1" + 30 * "0", "1e9", '"../../x"')


@pytest.mark.parametrize(
    "name",
    [*(pytest.param(one, marks=pytest.mark.campaign) for one in ("rocksat", "rocksat_serial", "dymaflex")), "workshop"],
)
def test_any_value_put_for_any_other_is_refused_or_can_be_flown(name: str) -> None:
    path = config.packaged(name)
    lines = path.read_text(encoding="utf-8").splitlines()
    assigned = [(n, re.match(r"\s*[\w.]+\s*=\s*", line)) for n, line in enumerate(lines)]
    places = [(n, t.span()) for n, start in assigned if start for t in TOKEN.finditer(lines[n], start.end())]
    cases = [(place, value) for place in places for value in EXTREMES]
    outcomes = {"refused": 0, "flown": 0}
    for (number, (first, last)), value in random.Random(13).sample(cases, 120):
        changed = [*lines]
        changed[number] = changed[number][:first] + value + changed[number][last:]
        try:
            vehicle = config.parse("\n".join(changed), path)
            estimator = Estimator(vehicle)
        except config.ConfigError:
            outcomes["refused"] += 1
            continue
        assert max(vehicle.rate_hz(device) for device in vehicle.file.device) < 1e5, changed[number]
        empty = {channel: np.zeros(0, dtype) for channel, dtype in vehicle.channels.items()}
        for step in range(3):
            estimator.process(10**9 + round(step * vehicle.file.estimation.step_ms * 1e6), empty)
        outcomes["flown"] += 1
    assert outcomes["refused"] > 50
    assert outcomes["flown"] > 3


def test_tables_laid_over_a_file_are_its_text_too() -> None:
    """The log keeps the text: what flew can be replayed."""
    vehicle = config.load(config.packaged("rocksat"))
    tree = config.laid_over(vehicle.tree, {"estimation": {"step_ms": 40}})
    other = config.parse_tree(tree, vehicle.path, config.Origin("a plan"))
    again = config.parse(other.text, vehicle.path)
    assert again.tree == tree
    assert again.file.estimation.step_ms == 40


def test_a_free_body_without_moving_joints_is_refused_with_what_it_shows(tmp_path: Path) -> None:
    inertial = '<inertial><mass value="5"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    links = "".join(f'<link name="{name}">{inertial}</link>' for name in ("base", "payload"))
    fixed = '<joint name="held" type="fixed"><parent link="base"/><child link="payload"/></joint>'
    (tmp_path / "body.urdf").write_text(f'<robot name="body">{links}{fixed}</robot>')
    text = config.packaged("dymaflex").read_text().replace("dymaflex.urdf", "body.urdf")
    with pytest.raises(config.ConfigError, match=r"vehicle.toml:7: no joint of the URDF moves, .*free_body.md"):
        config.parse(text, tmp_path / "vehicle.toml")
