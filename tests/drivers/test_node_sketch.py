"""The sketch of deploy/node, compiled on stand-ins of Arduino's API, its bytes decoded, and the page that wires it."""

import re
import shutil
import subprocess
import textwrap
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from drivers.node_frame import FrameStream, decode_descriptor, payload_dtype
from onboard import config

ROOT = Path(__file__).resolve().parents[2]
STRICT = ["-Wall", "-Wextra", "-Werror", "-Wshadow", "-fsanitize=undefined", "-fno-sanitize-recover=all", "-g"]
PAGE = ROOT / "docs" / "node_frame.md"
NOT_VALID = 1
EARLIEST_US = (1 << 32) - 2_500_000  # what its clock shows when it starts


class Run(NamedTuple):
    """A node's descriptors and data frames, and what really was."""

    descriptors: list
    frames: np.ndarray
    conversions: np.ndarray  # number, us, encoder
    pulses: dict[int, int]
    wrote: list[str]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    if shutil.which("cc") is None or shutil.which("c++") is None:
        pytest.skip("no C++ compiler: install g++")
    folder, node, here = tmp_path_factory.mktemp("sketch"), ROOT / "deploy" / "node", Path(__file__).parent / "arduino"
    encoder, program = folder / "heft_node.o", folder / "board"
    subprocess.run(["cc", "-std=c99", *STRICT, "-c", str(node / "heft_node.c"), "-o", str(encoder)], check=True)
    includes = [f"-I{where}" for where in (here, node, node / "arm_node")]
    source = str(here / "board.cpp")
    subprocess.run(["c++", "-std=c++17", *STRICT, *includes, source, str(encoder), "-o", str(program)], check=True)
    ran = subprocess.run([str(program)], capture_output=True, check=True, timeout=60)
    stream = FrameStream()
    stream.receive(ran.stdout)
    payloads = stream.take()
    assert payloads is not None
    descriptors = [decode_descriptor(payload) for payload in payloads if payload[0] == 0x11]
    dtype = payload_dtype(descriptors[0].channels)
    frames = np.concatenate([np.frombuffer(payload, dtype) for payload in payloads if payload[0] == 0x10])
    said = [line.split() for line in ran.stderr.decode().splitlines()]
    conversions = np.array([[int(word) for word in line[1:]] for line in said if line[0] == "conversion"])
    pulses = {int(line[1]): int(line[2]) for line in said if line[0] == "pulse"}
    return Run(descriptors, frames, conversions, pulses, [" ".join(line[1:]) for line in said if line[0] == "wrote"])


def test_it_describes_itself_once_a_second(run):
    assert len(run.descriptors) == pytest.approx(8, abs=1)
    first = run.descriptors[0]
    assert (first.node, first.tick_hz, first.sequence) == (7, 1_000_000, 0)
    scales = {channel.name: (channel.scale, channel.unit) for channel in first.channels}
    assert scales["accel_x"] == (pytest.approx(4.0 / 32768, rel=1e-9), "g")
    assert scales["gyro_z"] == (pytest.approx(1.0 / 65.5, rel=1e-9), "deg/s")
    assert scales["angle"] == (pytest.approx(2.0 * np.pi / 4096, rel=1e-9), "rad")
    assert scales["force"] == (pytest.approx(50.0 / (2e-3 * 2 * 128 * (1 << 23)), rel=1e-9), "N")
    ticks = [one.tick for one in run.descriptors]
    assert ticks == sorted(ticks)
    assert ticks[-1] - ticks[0] == pytest.approx(7e6, rel=0.05)  # over the wrap of its 32 bits
    assert {one.schema for one in run.descriptors} == {first.schema}


def test_both_chips_are_set_up_as_their_data_sheets_say(run):
    imu = [line[3:] for line in run.wrote if line.startswith("68")]
    cell = [line[3:] for line in run.wrote if line.startswith("2a")]
    assert imu[:6] == ["6b 80", "6b 01", "19 00", "1a 03", "1b 08", "1c 08"]
    assert cell == ["00 01", "00 02", "01 2f", "02 70", "1c 80", "15 30", "00 86", "02 74", "00 96"]


def test_each_conversion_is_a_frame_with_its_time_its_force_and_the_angle_of_that_instant(run):
    frames, numbers = run.frames, run.frames["sequence"]
    assert len(frames) > 0.93 * len(run.conversions)
    true = run.conversions[numbers]
    late_us = (frames["tick"].astype(np.int64) - true[:, 1] - EARLIEST_US) % (1 << 32)
    assert late_us.max() <= 2
    names = [channel.name for channel in run.descriptors[0].channels]
    values = {name: frames[field] for name, field in zip(names, frames.dtype.names[-len(names) - 1 : -1], strict=True)}
    read = values["force"] - 100_000
    assert set(np.unique(read - true[:, 0])) <= {0, 1, 2, 3}  # newer ones where the bus was stretched
    assert np.mean(read == true[:, 0]) > 0.99
    assert (values["angle"] == true[:, 2]).all()
    good = frames["status"] == 0
    for name, word in zip(("accel_x", "accel_y", "accel_z"), (1000, -2000, 3000), strict=True):
        assert set(values[name][good]) == {word}
    for name, word in zip(("gyro_x", "gyro_y", "gyro_z"), (5000, -6000, 7000), strict=True):
        assert set(values[name][good]) == {word}


def test_pulses_are_those_of_the_line_by_the_nodes_clock(run):
    frames = run.frames
    seen = {int(f["pulse"]): int(f["pulse_tick"]) for f in frames if f["pulse"]}
    assert len(seen) > 30
    for number, tick in seen.items():
        assert (tick - run.pulses[number] - EARLIEST_US) % (1 << 32) <= 2
    times_us = run.conversions[frames["sequence"], 1]
    assert all(run.pulses.get(int(f["pulse"]) + 2, 1 << 40) > t for f, t in zip(frames, times_us, strict=True))


def test_what_it_had_no_time_or_room_for_is_a_gap(run):
    numbers = run.frames["sequence"].astype(int)
    assert (np.diff(numbers) > 0).all()
    times_s = run.conversions[numbers, 1] * 1e-6
    gaps = {round(float(times_s[at]), 1): int(np.diff(numbers)[at]) - 1 for at in np.flatnonzero(np.diff(numbers) > 1)}
    assert 2 <= gaps[3.0] <= 4  # 10 ms
    assert gaps[5.0] == pytest.approx(0.1 * 324, abs=3)  # the IMU is set up again
    assert gaps[5.5] == pytest.approx(0.2 * 324, abs=12)  # the UART is full


def test_an_imu_that_does_not_answer_is_not_valid_and_set_up_again(run):
    times_s = run.conversions[run.frames["sequence"], 1] * 1e-6
    bad = times_s[run.frames["status"] == NOT_VALID]
    assert bad[0] == pytest.approx(4.0, abs=0.01)
    assert 4.2 < bad[-1] < 5.3
    assert [line for line in run.wrote if line.startswith("68")].count("68 6b 80") == 2


def test_the_lines_of_the_page_are_those_of_the_sketch(run, tmp_path):
    """Names, and a vehicle that loads."""
    (block,) = re.findall(r"^ *```toml\n(.*?)^ *```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    block = textwrap.dedent(block)
    named = re.findall(r'^name = "(\w+)"', block, re.MULTILINE)
    assert named == [channel.name for channel in run.descriptors[0].channels]
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    links = "".join(f'<link name="{name}">{inertial}</link>' for name in ("body", "arm"))
    joint = (
        '<joint name="joint_1" type="continuous"><axis xyz="0 0 1"/><parent link="body"/><child link="arm"/></joint>'
    )
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm">{links}{joint}</robot>', encoding="utf-8")
    above = '[vehicle]\nname = "arm"\nurdf = "arm.urdf"\nbase = "prescribed"\nbase_link = "body"\n'
    vehicle = config.parse(above + block, tmp_path / "vehicle.toml")
    assert vehicle.file.device["wrist"].node == run.descriptors[0].node
    sketch = (ROOT / "deploy" / "node" / "arm_node" / "arm_node.ino").read_text(encoding="utf-8")
    baud = re.search(r"LINK_BAUD = (\d+)", sketch)
    assert baud is not None
    assert f"baud={baud[1]}" in block
