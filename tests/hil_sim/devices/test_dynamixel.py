"""The simulated DYNAMIXEL servos against the e-manual: packets, control table, several on one line, faults."""

import math
import struct

import numpy as np
import pytest

from hil_sim.buses.serial_bus import SerialBus
from hil_sim.buses.serial_port import VirtualSerial
from hil_sim.devices.serial_line.dynamixel import DynamixelTwin, asks, crc
from hil_sim.devices.serial_wire import Heard, LineFormat
from hil_sim.faults import Fault, FaultError, FaultPlan
from tests.hil_sim.devices.serial_bench import Line
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog

FAST_LINE = LineFormat(1_000_000)


def servo(angle=0.0, torque=0.0, *faults, **options):
    """A servo whose angle [rad] and torque [N m] are given, or functions of mission time."""
    inputs = [Analog(one if callable(one) else lambda t, one=one: one) for one in (angle, torque)]
    return DynamixelTwin(*inputs, START_NS, faults=FaultPlan(faults, START_NS).of("servo"), **options)


class Bench(Line):
    """One servo on its line."""

    def __init__(self, *arguments, **options):
        super().__init__(servo(*arguments, **options))
        self.run(1)

    def say(self, body, identifier=1, ms=5):
        """Send an instruction in hex; error byte and data of the answer, None without one."""
        return parts(self.ask(packet(body, identifier), ms))

    def read(self, address, form):
        error, data = self.say(f"02 {struct.pack('<HH', address, struct.calcsize(form)).hex()}")
        assert error & 0x7F == 0
        return struct.unpack(form, data)

    def write(self, address, data):
        return self.say(f"03 {struct.pack('<H', address).hex()} {data}")[0]


def packet(body, identifier=1):
    body = bytes.fromhex(body)
    head = b"\xff\xff\xfd\x00" + bytes([identifier]) + struct.pack("<H", len(body) + 2) + body
    return head + crc(head)


def parts(answer):
    if not answer:
        return None
    assert answer[:4] == b"\xff\xff\xfd\x00"
    assert answer[-2:] == crc(answer[:-2])
    assert (answer[7], struct.unpack("<H", answer[5:7])[0]) == (0x55, len(answer) - 7)
    return answer[8], answer[9:-2]


class Chain:
    """Several servos on one line, and the flight computer's port."""

    def __init__(self, *servos, line=FAST_LINE):
        self.adapter = VirtualSerial("/dev/hil-servos")
        self.bus = SerialBus(self.adapter)
        for one in servos:
            self.bus.add(one, asks=asks)
        self.now_ns = START_NS
        self.bus.advance(START_NS)
        self.port = self.adapter.open(line)
        self.run(1)

    def run(self, ms):
        self.now_ns += round(ms * MS)
        self.bus.advance(self.now_ns)

    def ask(self, data, ms=5):
        self.port.write(data)
        self.run(ms)
        return self.port.read(1000)


# The examples of the manual


def at_counts(counts):
    return (counts - 2048) * math.tau / 4096


def quiet(monkeypatch):
    monkeypatch.setattr("hil_sim.devices.serial_line.dynamixel._NOISE_COUNTS", 0.0)


def test_crc_check_value():
    assert crc(b"123456789") == (0xFEE8).to_bytes(2, "little")


def test_ping_and_read_of_the_manual(monkeypatch):
    quiet(monkeypatch)
    bench = Bench(at_counts(166), firmware=38)
    answer = bench.ask(bytes.fromhex("FF FF FD 00 01 03 00 01 19 4E"), 5)
    assert answer.hex(" ").upper()[:-6] == "FF FF FD 00 01 07 00 55 00 FC 03 26"  # 1020: an XM430-W350
    answer = bench.ask(bytes.fromhex("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"), 5)
    assert answer == bytes.fromhex("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0")


def test_sync_read_of_the_manual(monkeypatch):
    quiet(monkeypatch)
    chain = Chain(servo(at_counts(2079), identifier=2), servo(at_counts(166), identifier=1))
    answer = chain.ask(bytes.fromhex("FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA"))
    first = "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"
    assert answer == bytes.fromhex(f"{first} FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE")


@pytest.mark.parametrize("step_ms", [0.01, 0.3, 5])
@pytest.mark.parametrize("return_delay", [0, 250])
@pytest.mark.parametrize("positions", [{7: 2079, 4: 1023, 3: 166}, {3: 166, 7: 2079, 4: 1023}])
def test_fast_sync_read_of_the_manual(monkeypatch, positions, return_delay, step_ms):
    quiet(monkeypatch)
    options = {"return_delay": return_delay}
    chain = Chain(*(servo(at_counts(one), identifier=identifier, **options) for identifier, one in positions.items()))
    chain.port.write(bytes.fromhex("FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2"))
    for _ in range(round(5 / step_ms)):
        chain.run(step_ms)
    assert chain.port.read(1000).hex(" ").upper() == (
        "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08 00 07 1F 08 00 00 16 CA 00 04 FF 03 00 00 D1 9E"
    )


# Packets


def test_no_packet_ends_before_it_has_what_it_lacks():
    """Packets, their beginnings, and noise in which headers are: what it does, it does at a character foreseen."""
    rng, one = np.random.default_rng(4), servo()
    one.act(START_NS)
    due_ns, now_ns, ended, allowed = one.due_ns, START_NS, 0, 0
    for _ in range(2000):
        whole = packet("02 84 00 04 00", int(rng.integers(3)))
        noise = bytes(rng.choice([0xFF, 0xFD, 0, 1, 3], 4).tolist())
        for byte in (whole, whole[: rng.integers(len(whole))], noise, whole[:4])[rng.integers(4)]:
            lacks, now_ns = one.lacks, now_ns + 10_000
            assert lacks >= 1
            allowed = max(allowed - 1, lacks)
            one.receive(byte, now_ns)
            if one.due_ns != due_ns:
                assert allowed == lacks == 1
                one.act(one.due_ns)
                ended, due_ns = ended + 1, one.due_ns
    assert ended > 100


def test_what_is_gathered_is_what_is_received_one_by_one():
    """Packets, parts of them and noise, with pauses, to one without a fault, or off or silent for a while."""
    rng = np.random.default_rng(5)
    for faults in ((), (Fault("off", "servo", 0.1, 0.7),), (Fault("silent", "servo", 0.0, 0.7),)):
        one, other = servo(0.0, 0.0, *faults), servo(0.0, 0.0, *faults)
        now_ns = START_NS - 1_000_000  # it is not on yet
        for _ in range(500):
            for twin in (one, other):
                twin.act(now_ns)
            whole = packet("02 84 00 04 00", int(rng.integers(3)))
            data = (whole, whole[: rng.integers(1, len(whole))], b"\xff\xff", bytes(3))[rng.integers(4)]
            heard = [Heard(now_ns + k, byte) for k, byte in enumerate(data)]
            fewer = heard[: one.lacks - 1]
            if fewer:
                one.gather(fewer)
            else:
                one.receive(data[0], now_ns)
            for character in fewer or heard[:1]:
                other.receive(character.byte, character.end_ns)
            assert (one.lacks, one.due_ns, one.memory) == (other.lacks, other.due_ns, other.memory)
            now_ns += int(rng.choice([10_000, 3_000_000, 150_000_000], p=[0.8, 0.18, 0.02]))


def test_when_it_answers():
    bench = Bench()
    bench.send(packet("02 84 00 04 00"))
    asked_ns = bench.now_ns
    bench.run(5)
    assert bench.ends_ns[0] - asked_ns == pytest.approx(14 * 10_000 + 500_000 + 10_000)  # 14 characters, 250 x 2 us
    assert bench.write(9, "00") == 7  # the torque is on
    assert bench.write(64, "00") == 0
    assert bench.write(9, "00") == 0
    bench.send(packet("02 84 00 04 00"))
    asked_ns = bench.now_ns
    bench.run(5)
    assert bench.ends_ns[0] - asked_ns == pytest.approx(15 * 10_000)


@pytest.mark.parametrize("bit", range(32, 8 * 14))
def test_no_packet_with_an_inverted_bit_is_obeyed(bit):
    bench = Bench()
    spoilt = bytearray(packet("02 84 00 04 00"))
    spoilt[bit // 8] ^= 1 << bit % 8
    assert parts(bench.ask(bytes(spoilt), 5)) in (None, (3, b""))
    assert bench.device.answered <= 1


def test_junk_before_a_packet_and_packets_of_others_are_passed_over():
    bench = Bench()
    for junk in (b"\xff\xff\x00\xff\xff\xff\xfd", b"\x00\x12\xff\xff", b"\xff\xff\xfd\xfd"):
        assert parts(bench.ask(junk + packet("01"), 5)) is not None
    assert bench.say("01", identifier=2) is None


def test_what_never_ends_is_given_up():
    bench = Bench()
    assert bench.ask(b"\xff\xff\xfd\x00\x01\x00\x02") == b""  # 512 bytes follow: that is no packet
    assert parts(bench.ask(packet("01"))) is not None
    assert bench.ask(b"\xff\xff\xfd\x00\x01\xff\x01", 50) == b""
    assert bench.ask(packet("01")) == b""
    bench.run(101)
    assert parts(bench.ask(packet("01"))) is not None


def test_a_servo_that_lost_its_supply_has_lost_its_turn():
    faults = Fault("off", "servo", 0.0069, 0.008)  # between the request and its answer
    chain = Chain(servo(identifier=1, return_delay=250), servo(0.0, 0.0, faults, identifier=2))
    chain.run(5.5)
    assert len(chain.ask(sync_read(1, 2))) == 22
    assert len(chain.ask(sync_read(1, 2))) == 22  # it starts


def test_what_is_stuffed_is_taken_out_and_put_in():
    bench = Bench(zero_count=0, angle=at_counts(2048))
    bench.device.memory[200:206] = bytes.fromhex("FF FF FD FD FF FF")
    answer = bench.ask(packet("02 C8 00 06 00"), 5)
    assert answer[7:-2] == bytes.fromhex("55 00 FF FF FD FD FD FF FF")
    assert bench.say("02 FF FF FD FD 00") == (7, b"")  # address FFFFh: stuffed, and not there


def test_errors():
    bench = Bench()
    assert bench.say("06 01") == (2, b"")
    assert bench.say("02 00 03 01 00") == (7, b"")
    assert bench.write(70, "00") == 7
    assert bench.write(64, "02") == 4
    assert bench.write(116, "00 02") == 5
    assert bench.write(116, "00 02 00 00") == 0
    assert bench.read(116, "<i") == (512,)


def test_status_return_level():
    bench = Bench()
    assert bench.write(68, "01") is not None or bench.read(68, "B") == (1,)
    assert bench.say("03 41 00 01") is None
    assert bench.read(65, "B") == (1,)
    bench.say("03 44 00 00")
    assert bench.say("02 41 00 01 00") is None
    assert bench.say("01") is not None


def test_every_servo_answers_a_broadcast_ping_one_after_the_other():
    chain = Chain(servo(identifier=5), servo(identifier=1), servo(identifier=9))
    answer = chain.ask(packet("01", 0xFE), 40)
    assert [answer[at + 4] for at in range(0, len(answer), 14)] == [1, 5, 9]


def test_baud_rate_is_changed_at_once_and_kept():
    chain = Chain(servo())
    assert parts(chain.ask(packet("03 40 00 00"))) == (0, b"")
    chain.ask(packet("03 08 00 01"))
    assert chain.ask(packet("01")) == b""
    chain.port.baudrate = 57_600
    chain.run(1)
    assert parts(chain.ask(packet("01"), 10)) is not None


@pytest.mark.parametrize("bad", [{"identifier": 253}, {"line": LineFormat(115_201)}])
def test_what_it_cannot_be_is_refused(bad):
    with pytest.raises(ValueError, match="it has 0 to 252"):
        servo(**bad)


# Measurements


def test_position_velocity_and_current():
    bench = Bench(lambda t: 0.5 + 0.8 * t, 1.78 * 0.5, turns=2.0)
    bench.run(500)
    angle, rate = 2.0 * (0.5 + 0.8 * 0.5), 1.6
    current, velocity, position = bench.read(126, "<hii")
    assert position == pytest.approx(2048 + angle * 4096 / math.tau, abs=8)
    assert velocity * 0.229 * math.tau / 60 == pytest.approx(rate, abs=0.03)
    assert current * 2.69e-3 == pytest.approx(0.25, abs=2e-3)
    assert bench.read(144, "<HB") == (120, 38)
    assert bench.write(64, "00") == 0
    assert bench.read(126, "<h") == (0,)


def test_the_position_begins_in_the_first_revolution_and_goes_on_over_it():
    bench = Bench(lambda t: 20.0 + t)
    assert 0 <= bench.read(132, "<i")[0] < 4096
    first, bench_turns = bench.read(132, "<i")[0], 2
    bench.run(bench_turns * math.tau * 1e3)
    assert bench.read(132, "<i")[0] == pytest.approx(first + 4096 * bench_turns, abs=12)


def test_noise_is_a_third_of_a_count():
    bench = Bench(at_counts(1000.5))
    seen = []
    for _ in range(200):
        seen += bench.read(132, "<i")
    assert {999, 1000, 1001, 1002} >= set(seen) >= {1000, 1001}


# Several on a line


def sync_read(*identifiers, fast=True, count=10):
    return packet(f"{'8A' if fast else '82'} 7E 00 {count:02X} 00 {bytes(identifiers).hex()}", 0xFE)


def test_only_sync_reads_ask_for_samples():
    chain = Chain(servo(identifier=1), servo(identifier=2))
    for message in (packet("01"), sync_read(1, 2), packet("02 84 00 04 00"), sync_read(2, 1, fast=False)):
        chain.ask(message)
    assert chain.bus.questions == 2


@pytest.mark.parametrize("fast", [True, False])
def test_those_behind_a_silent_servo_wait_for_it(fast):
    silent = Fault("silent", "servo", 0.01, 0.02)
    chain = Chain(servo(identifier=1), servo(0.0, 0.0, silent, identifier=2), servo(identifier=3))
    whole = len(chain.ask(sync_read(1, 2, 3, fast=fast)))
    assert whole == (8 + 3 * 14 if fast else 3 * 21)
    chain.run(5)
    assert len(chain.ask(sync_read(1, 2, 3, fast=fast))) == (22 if fast else 21)
    assert len(chain.ask(sync_read(1, 3, fast=fast))) == (36 if fast else 42)
    chain.run(10)
    assert len(chain.ask(sync_read(3, 2, 1, fast=fast))) == whole


def test_an_old_firmware_has_no_fast_sync_read():
    chain = Chain(servo(identifier=1, firmware=44))
    assert chain.ask(sync_read(1)) == b""
    assert len(chain.ask(sync_read(1, fast=False))) == 21


# Faults


def test_a_hardware_error_sets_the_alert_and_ends_with_a_reboot():
    bench = Bench(0.0, 1.0, Fault("trip", "servo", 0.1), Fault("trip", "servo", 0.2, value=4))
    assert bench.read(126, "<h")[0] > 100
    bench.run(120)
    assert bench.say("02 46 00 01 00") == (0x80, b"\x20")
    assert bench.read(126, "<h") == (0,)
    assert bench.read(64, "B") == (0,)
    bench.run(100)
    assert bench.say("02 46 00 01 00") == (0x80, b"\x24")
    assert bench.read(146, "B") == (81,)
    assert bench.say("08") == (0x80, b"")
    bench.run(100)
    assert bench.say("01") is None  # it starts
    bench.run(400)
    assert bench.say("02 46 00 01 00") == (0, b"\0")


def test_supply_and_input_faults():
    faults = [
        Fault("off", "servo", 0.1, 0.2),
        Fault("stuck", "servo", 1.0, 1.2),
        Fault("wrong", "servo", 1.4, 1.6, 0.5),
    ]
    bench = Bench(lambda t: 0.1 * t, 1.0, *faults)
    bench.run(150)
    assert bench.say("01") is None
    bench.run(100)
    assert bench.say("01") is None
    bench.run(400)
    assert bench.say("01") is not None
    bench.run(400)
    held = bench.read(132, "<i")[0]
    bench.run(100)
    assert abs(bench.read(132, "<i")[0] - held) < 8
    bench.run(300)
    amperes = bench.read(126, "<h")[0] * 2.69e-3
    assert amperes == pytest.approx(1.5 / 1.78, abs=2e-3)


def test_a_fault_that_it_cannot_have_is_refused():
    with pytest.raises(FaultError):
        servo(0.0, 0.0, Fault("nack", "servo", 1.0))


def test_requests_that_come_together_after_a_pause_are_counted_each():
    ping = bytes.fromhex("FFFFFD00 01 0300 01 194E")  # the manual's example
    read = bytes.fromhex("FFFFFD00 FE 0900 82 7E00 0A00 01 02 0000")
    fast = bytes.fromhex("FFFFFD00 FE 0900 8A 7E00 0A00 01 02 0000")
    assert [asks(message) for message in (b"", ping, read, fast)] == [0, 0, 1, 1]
    assert asks(ping + read) == asks(read + ping) == 1
    assert asks(read + fast) == 2
