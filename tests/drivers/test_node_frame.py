"""The node frame's decoder and its encoder in C, against an encoder typed from docs/node_frame.md."""

import re
import struct
import subprocess

import numpy as np
import pytest
from cobs import cobs
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import FrameError
from drivers.node_frame import FrameChannel, FrameStream, decode_descriptor, payload_dtype
from drivers.node_frame.frame import LONGEST_FRAME, decode_frame
from tests.drivers.node_model import NodeModel, crc16, framed, stuffed
from tests.drivers.serial_script import bytewise, fed, pieces, whole
from tests.node_encoder import ROOT, STRICT, CEncoder, built, needs_compiler

FORCE = ("force", "N", 5, 0, 1, -4)

# The two frames that docs/node_frame.md prints
DESCRIPTOR = bytes.fromhex(
    "05 11 07 36 76 01 01 01 01 01 01 01 01 01 01 01 01 01 01 01 04 40 42 0f 03 01 05 02 01 01 01 03 fc 4e"
    "01 01 01 01 01 01 06 66 6f 72 63 65 01 01 01 01 01 01 01 01 01 01 03 70 fc 00"
)
DATA = bytes.fromhex("05 10 07 36 76 01 01 01 03 e8 03 01 02 01 01 01 03 84 03 01 01 07 c0 1d fe ff 91 7d 00")


def test_check_values_of_crc_and_cobs():
    assert crc16(b"123456789") == 0x29B1
    for data in (b"", b"\0", b"\0" * 300, b"\1" * 254, b"\1" * 255, b"\1" * 254 + b"\0", b"\1" * 600 + b"\0\0\2"):
        assert stuffed(data) == cobs.encode(data)


def test_the_printed_frames_are_what_the_page_describes():
    node = NodeModel([FORCE], node=7)
    assert node.descriptor(0) == DESCRIPTOR
    node.edge(900)
    assert node.data(1000, -123456) == DATA
    page = re.sub(r"\s+", " ", (ROOT / "docs" / "node_frame.md").read_text(encoding="utf-8"))
    assert DESCRIPTOR.hex(" ") in page
    assert DATA.hex(" ") in page


def test_the_printed_frames_decode():
    told = decode_descriptor(decode_frame(DESCRIPTOR[:-1]))
    assert told[:6] == (7, 0x7636, 0, 0, 0, 1_000_000)
    assert told.channels == (FrameChannel("force", "<i4", False, 1e-4, "N"),)
    (frame,) = np.frombuffer(decode_frame(DATA[:-1]), payload_dtype(told.channels))
    assert frame.tolist()[:-1] == (0x10, 7, 0x7636, 0, 1000, 1, 900, 0, -123456)


def test_scales_are_the_nearest_double_of_their_decimal_text():
    for mantissa, exponent, scale in ((1, -3, 0.001), (1533980788, -12, 1.533980788e-3), (-5, 2, -500.0), (7, 0, 7.0)):
        model = NodeModel([("x", "1", 5, 0, mantissa, exponent)])
        assert decode_descriptor(decode_frame(model.descriptor(0)[:-1])).channels[0].scale == scale


BAD_DESCRIPTORS = {
    "cut short": lambda p: p[:22],
    "channel count": lambda p: p[:24] + b"\x02" + p[25:],
    "schema": lambda p: p[:2] + b"\0\0" + p[4:],
    "kind": lambda p: b"\x10" + p[1:],
}


@pytest.mark.parametrize("spoil", BAD_DESCRIPTORS.values(), ids=BAD_DESCRIPTORS)
def test_a_descriptor_that_contradicts_itself_is_refused(spoil):
    payload = cobs.decode(DESCRIPTOR[:-1])
    assert decode_descriptor(payload).node == 7
    with pytest.raises(FrameError):
        decode_descriptor(spoil(payload[:-2]) + payload[-2:])


@pytest.mark.parametrize(
    ("channels", "tick_hz"),
    [
        ([("x", "1", 7, 0, 1, 0)], 1),
        ([("\x01", "1", 0, 0, 1, 0)], 1),
        ([("a\0b", "1", 0, 0, 1, 0)], 1),
        ([("x", "\x7f", 0, 0, 1, 0)], 1),
        ([FORCE], 0),
        ([], 1),
    ],
)
def test_a_descriptor_that_cannot_be_used_is_refused(channels, tick_hz):
    frame = NodeModel(channels, tick_hz=tick_hz).descriptor(5)
    with pytest.raises(FrameError):
        decode_descriptor(decode_frame(frame[:-1]))


def test_a_clock_of_more_than_62_bits_is_refused():
    with pytest.raises(FrameError, match="tick 0x4000000000000000"):
        decode_descriptor(decode_frame(NodeModel([FORCE]).descriptor(2**62)[:-1]))


@pytest.mark.parametrize("bad", [b"", b"\x01", b"\x05ab", stuffed(b"ab"), stuffed(b"abcdef"), DATA[:-2]])
def test_what_is_no_frame_is_refused(bad):
    with pytest.raises(FrameError):
        decode_frame(bad)


@pytest.fixture
def run():
    """Frames of two channels, and their payloads."""
    node = NodeModel([FORCE, ("angle", "rad", 2, 1, 1533980788, -12)])
    frames = [node.descriptor(0), *(node.data(1000 * n, -n, n) for n in range(200)), node.descriptor(200_000)]
    return frames, [cobs.decode(frame[:-1]) for frame in frames]


FEEDS = {"whole": whole, "bytewise": lambda _: bytewise(), "pieces": lambda _: pieces(3)}


@pytest.mark.parametrize("feed", FEEDS.values(), ids=FEEDS)
@pytest.mark.parametrize("before", [b"", b"\0", DATA[5:], b"\0\0\0\0"], ids=["", "delimiter", "half a frame", "zeros"])
@pytest.mark.parametrize("after", [b"", DATA[:9], b"\0"], ids=["", "half a frame", "delimiter"])
def test_fed_any_way_the_same_comes_out(run, feed, before, after):
    frames, payloads = run
    data = before + b"".join(frames) + after
    taken, errors = fed(FrameStream(), data, feed(data))
    assert [payload for piece in taken for payload in piece] == payloads
    assert len(errors) == (before == DATA[5:])


@pytest.mark.parametrize("at", [0, 1, 25, 26])
def test_every_spoiled_byte_costs_one_frame_and_is_told(run, at):
    frames, payloads = run
    spoiled = bytearray(frames[100])
    spoiled[at] ^= 0x40
    data = b"".join([*frames[:100], bytes(spoiled), *frames[101:]])
    taken, errors = fed(FrameStream(), data, whole(data))
    assert [payload for piece in taken for payload in piece] == payloads[:100] + payloads[101:]
    assert len(errors) == 1


def test_a_lost_delimiter_costs_the_two_frames_it_parted(run):
    frames, payloads = run
    data = b"".join([*frames[:9], frames[9][:-1], *frames[10:]])
    taken, errors = fed(FrameStream(), data, bytewise())
    assert [payload for piece in taken for payload in piece] == payloads[:9] + payloads[11:]
    assert len(errors) == 1


def test_bytes_without_end_are_thrown_away(run):
    frames, payloads = run
    noise = b"\x55" * (3 * LONGEST_FRAME)
    taken, errors = fed(FrameStream(), noise + b"\0" + b"".join(frames), pieces(1))
    assert [payload for piece in taken for payload in piece] == payloads
    assert errors
    stream = FrameStream()
    fed(stream, noise, pieces(2))
    assert len(stream.waiting) <= LONGEST_FRAME


def test_a_broken_stream_forgets_its_half_frame():
    stream = FrameStream()
    stream.receive(DATA + DATA[:9])
    stream.clear()
    stream.receive(DATA[9:] + DATA)
    with pytest.raises(FrameError):
        stream.take()
    assert len(stream.take()) == 1


@given(st.binary(max_size=120), st.booleans())
def test_any_descriptor_is_read_or_refused(body, repair):
    payload = struct.pack("<BBHIQI", 0x11, 1, crc16(body) if repair else 0, 0, 0, 0) + body + b"\0\0"
    try:
        told = decode_descriptor(payload)
    except FrameError:
        return
    assert told.channels


@given(st.binary(max_size=60), st.binary(max_size=60))
def test_a_frame_after_any_junk_and_a_delimiter_is_found(junk, more):
    stream = FrameStream()
    taken, _ = fed(stream, junk + b"\0" + framed(b"abcd" + more), bytewise())
    assert taken[-1][-1][:-2] == b"abcd" + more


# The encoder in C


@pytest.fixture(scope="session")
def library(tmp_path_factory):
    return built(tmp_path_factory.mktemp("node"))


@needs_compiler
def test_the_example_on_the_page_compiles(tmp_path):
    page = (ROOT / "docs" / "node_frame.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```c\n(.*?)```", page, re.DOTALL)
    stubs = (
        "uint32_t boot_count(void); uint64_t clock_64(void); uint64_t captured_tick(void);\n"
        "uint64_t sample(int64_t *values); int a_second_is_over(void);\n"
        "void uart_send(const uint8_t *bytes, size_t count); void main_loop(void); void sync_line_interrupt(void);\n"
    )
    include = '#include "heft_node.h"\n'
    assert example.startswith(include)
    source = tmp_path / "example.c"
    source.write_text(include + stubs + example, encoding="utf-8")
    folder = ROOT / "deploy" / "node"
    subprocess.run(["cc", *STRICT, "-I", str(folder), "-c", str(source), "-o", str(tmp_path / "x.o")], check=True)


def test_the_encoder_makes_the_printed_frames(library):
    node = CEncoder(library, [FORCE], node=7)
    assert node.descriptor(0) == DESCRIPTOR
    node.edge(900)
    assert node.data(1000, -123456) == DATA
    assert node.node.sequence == 1


LIMITS = [(0, 0, 255), (1, -128, 127), (2, 0, 65535), (3, -32768, 32767), (4, 0, 2**32 - 1)]
LIMITS += [(5, -(2**31), 2**31 - 1), (6, -(2**63), 2**63 - 1)]


@st.composite
def nodes(draw):
    """Channels, and values for a few frames of them."""
    codes = draw(st.lists(st.integers(0, 6), min_size=1, max_size=40))
    text = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=8)
    channels = [
        (
            draw(text),
            draw(text),
            code,
            draw(st.integers(0, 255)),
            draw(st.integers(-(2**31), 2**31 - 1)),
            draw(st.integers(-128, 127)),
        )
        for code in codes
    ]
    sample = st.tuples(
        *(st.sampled_from([0, LIMITS[code][1], LIMITS[code][2]]) | st.integers(*LIMITS[code][1:]) for code in codes)
    )
    return channels, draw(st.lists(sample, min_size=1, max_size=4))


@settings(max_examples=40)
@given(nodes(), st.integers(0, 2**62 - 1), st.integers(0, 2**32 - 1), st.integers(0, 255))
def test_encoder_model_and_decoder_agree(library, node, tick, boot, status):
    channels, samples = node
    model, encoder = NodeModel(channels, 9, 170_000_000, boot), CEncoder(library, channels, 9, 170_000_000, boot)
    for sequence, values in enumerate(samples):
        frame = encoder.descriptor(tick)
        assert frame == model.descriptor(tick)
        told = decode_descriptor(decode_frame(frame[:-1]))
        assert (told.sequence, told.tick, told.boot) == (sequence, tick, boot)
        model.edge(tick)
        encoder.edge(tick)
        frame = encoder.data(tick, *values, status=status)
        assert frame == model.data(tick, *values, status=status)
        assert b"\0" not in frame[:-1]
        (row,) = np.frombuffer(decode_frame(frame[:-1]), payload_dtype(told.channels))
        assert row.tolist()[8:-1] == values
        assert row["status"] == status


def test_all_zero_values_and_frames_of_any_length_round_a_cobs_block(library):
    for value in (0, -1):
        for count in range(1, 66):
            channels = [(f"c{n}", "1", 6 if n % 2 else 1, 0, 1, 0) for n in range(count)]
            model, encoder = NodeModel(channels), CEncoder(library, channels)
            frame = encoder.data(0, *[value] * count)
            assert frame == model.data(0, *[value] * count)
            assert len(frame) <= 23 + 8 * count + (23 + 8 * count) // 254 + 2
            description = encoder.descriptor(0)
            assert description == model.descriptor(0)
            assert len(description) <= 27 + 31 * count + (27 + 31 * count) // 254 + 2
            assert len(description) <= LONGEST_FRAME + 64
    lengths = {len(CEncoder(library, [("x", "1", 6, 0, 1, 0)] * n).data(0, *[-1] * n)) for n in range(27, 31)}
    assert len(lengths) == 4


def test_a_buffer_that_is_too_small_takes_nothing_and_counts_nothing(library):
    encoder = CEncoder(library, [FORCE], node=7)
    for capacity in range(len(DESCRIPTOR)):
        assert encoder.descriptor(0, capacity) == b""
    assert encoder.descriptor(0, len(DESCRIPTOR)) == DESCRIPTOR
    encoder.edge(900)
    for capacity in range(len(DATA)):
        assert encoder.data(1000, -123456, capacity=capacity) == b""
    assert encoder.node.sequence == 0
    assert encoder.data(1000, -123456, capacity=len(DATA)) == DATA


def test_names_and_units_too_long_are_cut(library):
    encoder = CEncoder(library, [("a" * 20, "u" * 20, 0, 0, 1, 0)])
    (channel,) = decode_descriptor(decode_frame(encoder.descriptor(0)[:-1])).channels
    assert (channel.name, channel.unit) == ("a" * 16, "u" * 8)
