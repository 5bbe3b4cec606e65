"""The QSB twin against "QSB Command List" v1.28: formats, registers and factory values typed here."""

import pytest

from hil_sim.devices.serial_line.qsb import TICK_512_HZ, TICK_1900_US
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.faults import Fault
from tests.hil_sim.devices.qsb_bench import COUNT, FREE_X4, Bench, data_of, faults

# Formats


@pytest.mark.parametrize(
    ("eor", "answer"),
    [
        (b"0", b"r1413FA600E!"),
        (b"1", b"r1413FA600E!\n"),
        (b"2", b"r1413FA600E!\r"),
        (b"3", b"r1413FA600E!\r\n"),
        (b"8", b"r 14 13FA600E !"),
        (b"B", b"r 14 13FA600E !\r\n"),
    ],
)
def test_end_of_response(eor, answer):
    bench = Bench()
    bench.ask(b"W15" + eor + b"\r")
    assert bench.ask(b"R14\r") == answer


def test_a_full_line_is_26_bytes_and_1128_us():
    bench = Bench(angle=lambda t: 0x0001F4A2 * COUNT * (t > 1.0))
    bench.do(b"W15F", FREE_X4, b"W092", b"W0D1")
    bench.run((0x1234 + 0.5) * 1000 / 512 - 3)
    assert bench.ask(b"S0E\r", 2) == b"s 0E 0001F4A2 00001234 !\r\n"
    assert bench.ends_ns[-1] - bench.ends_ns[0] == pytest.approx(25 * 10 / 230_400 * 1e9, abs=1)


@pytest.mark.parametrize("end", [b"\r", b"\n", b"\r\n", b"\n\r"])
def test_any_end_of_command(end):
    assert Bench().ask(b"R15" + end) == b"r 15 0000000B !\r\n"


def test_backspace_deletes():
    assert Bench().ask(b"R16\x085\r") == b"r 15 0000000B !\r\n"
    assert Bench().ask(b"\x08\x08R15\r") == b"r 15 0000000B !\r\n"


def test_data_may_be_short_or_have_eight_digits_in_either_case():
    bench = Bench()
    assert bench.do(b"W081F3", b"W08000001f3", b"W08FFFFFFFF") == [
        "w 08 000001F3 !",
        "w 08 000001F3 !",
        "w 08 FFFFFFFF !",
    ]


@pytest.mark.parametrize(
    "command", [b"Q15", b"r15", b"R", b"R1", b"RXY", b"W15 F", b"W15000000000F", b"\xff\xfe", b"W15G", b"!" * 40]
)
def test_what_is_no_command_is_an_error(command):
    bench = Bench()
    assert bench.do(command, b"R15") == ["e 00 00000000 !", "r 15 0000000B !"]


# Registers


@pytest.mark.parametrize(
    ("register", "value"),
    [
        ("00", "00000000"),
        ("01", "0000000F"),
        ("02", "00000000"),
        ("03", "0000004F"),
        ("04", "00000000"),
        ("05", "00000000"),
        ("06", "0000000A"),
        ("07", "00000000"),
        ("08", "000001F3"),
        ("0B", "00000000"),
        ("0C", "0000FFFF"),
        ("0E", "00000000"),
        ("14", "13FA600E"),
        ("15", "0000000B"),
    ],
)
def test_factory_values(register, value):
    assert Bench(sync_input=False).do(b"R" + register.encode()) == [f"r {register} {value} !"]


@pytest.mark.parametrize("register", ["0F", "10", "13", "17", "7F", "FF"])
def test_other_registers_are_not_supported(register):
    code = register.encode()
    assert Bench().do(b"R" + code, b"W" + code + b"12", b"S" + code) == [
        f"x {register} 00000000 !",
        f"x {register} 00000012 !",
        f"x {register} 00000000 !",
    ]


@pytest.mark.parametrize(
    ("command", "answer"),
    [
        (b"W0512", "e 05 00000012 !"),
        (b"W0612", "e 06 00000012 !"),
        (b"W0712", "e 07 00000012 !"),
        (b"W0E1234", "e 0E 00001234 !"),
        (b"W141", "e 14 00000001 !"),
        (b"W03100", "e 03 00000100 !"),
        (b"W04200", "e 04 00000200 !"),
        (b"W1510", "e 15 00000010 !"),
        (b"W0C10000", "e 0C 00010000 !"),
        (b"W094", "e 09 00000004 !"),
        (b"W0A2", "e 0A 00000002 !"),
        (b"W162", "e 16 00000002 !"),
        (b"W1680A", "e 16 0000080A !"),
        (b"W03", "e 03 00000000 !"),
    ],
)
def test_a_refused_write_echoes_and_writes_nothing(command, answer):
    bench = Bench()
    before = bench.do(*(b"R%02X" % register for register in range(0x0D)))
    assert bench.do(command) == [answer]
    assert bench.do(*(b"R%02X" % register for register in range(0x0D))) == before


def test_streams_of_other_registers_are_not_supported():
    assert Bench().do(b"S03", b"S0D") == ["x 03 00000000 !", "x 0D 00000000 !"]


def test_clear_and_load():
    bench = Bench(angle=lambda t: 1234 * COUNT)
    bench.do(FREE_X4, b"W0877", b"W0A0")
    assert bench.do(b"R0E", b"W0A1", b"R07") == ["r 0E 00000077 !", "w 0A 00000001 !", "r 07 00000077 !"]
    assert bench.do(b"W092", b"R0E") == ["w 09 00000002 !", "r 0E 00000000 !"]
    assert bench.do(b"W04100", b"W091", b"R04") == ["w 04 00000100 !", "w 09 00000001 !", "r 04 00000000 !"]
    assert bench.do(b"W090", b"R03") == ["w 09 00000000 !", "r 03 00000000 !"]


def test_clearing_the_status_forgets_its_flags():
    bench = Bench(angle=lambda t: -3 * COUNT * (t > 0.2))
    bench.do(FREE_X4)
    bench.run(60)
    assert bench.do(b"R06", b"W093", b"R06") == ["r 06 00000049 !", "w 09 00000003 !", "r 06 00000009 !"]


def test_modulo_500_from_the_factory_and_free_running_when_told():
    bench = Bench(angle=lambda t: 1234 * COUNT * (t > 0.2))
    bench.run(100)
    assert bench.do(b"R0E") == [f"r 0E {1234 % 500:08X} !"]
    other = Bench(angle=lambda t: 1234 * COUNT * (t > 0.2))
    other.do(b"W0343")
    other.run(100)
    assert other.do(b"R0E") == [f"r 0E {1234:08X} !"]


def test_the_count_wraps_at_32_bits():
    bench = Bench(angle=lambda t: (-2 if t > 0.3 else 3 if t > 0.2 else 0) * COUNT)
    bench.do(FREE_X4)
    bench.run(80)
    assert bench.do(b"R0E") == ["r 0E 00000003 !"]
    bench.run(100)
    assert bench.do(b"R0E", b"R06") == ["r 0E FFFFFFFE !", "r 06 00000049 !"]  # borrow, enabled, down, negative


def test_bit_8_counts_down_and_bit_7_does_not():
    for mdr1, count in ((b"080", 0x64), (b"100", 0xFFFF_FF9C)):
        bench = Bench(angle=lambda t: 100 * COUNT * (t > 0.2))
        bench.do(FREE_X4, b"W04" + mdr1)
        bench.run(60)
        assert bench.do(b"R0E") == [f"r 0E {count:08X} !"]


# Time stamp


@pytest.mark.parametrize(("tick_ns", "ticks"), [(TICK_512_HZ, 5120), (TICK_1900_US, 5263)])
@pytest.mark.parametrize("rate_error", [0.0, 0.004])
def test_both_ticks_on_its_own_clock(tick_ns, ticks, rate_error):
    bench = Bench(tick_ns=tick_ns, rate_error=rate_error)
    bench.do(b"W15F", b"W0D1")
    first = int(bench.do(b"R0D")[0].split()[2], 16)
    bench.run(10_000 - 3)
    assert int(bench.do(b"R0D")[0].split()[2], 16) - first == pytest.approx(ticks * (1 + rate_error), abs=1)


def test_the_stamp_is_cleared_by_a_one_only_and_wraps_at_32_bits():
    bench = Bench(tick_ns=0.25)  # a fast one: 2^32 ticks in 1.07 s
    bench.do(b"W15F", b"W0D1")
    bench.run(1000)
    assert int(bench.do(b"W0D0", b"R0D")[1].split()[2], 16) > 4_000_000_000
    bench.run(100)
    assert int(bench.do(b"R0D")[0].split()[2], 16) < 300_000_000


# Supply, save, baud rate


def test_the_banner_comes_100_ms_after_power_up_and_nothing_is_obeyed_before():
    bench = Bench(boot=False)
    bench.run(10)
    assert bench.ask(b"R15\r", 89) == b""
    assert bench.run(5) == b"QSB-D  0E!\r\n"


def test_saved_registers_survive_and_the_count_does_not():
    angle = 777 * COUNT
    bench = Bench(angle=lambda t: angle * (t > 0.3), faults=faults(Fault("reset", "qsb", 0.5)))
    bench.do(FREE_X4, b"W15F", b"W0C3", b"W02010", b"W163", b"W0B7")
    bench.run(200)
    assert bench.do(b"R0E")[0].startswith("r 0E 00000309")
    bench.run(300)
    values = [answer.split()[2] for answer in bench.do(b"R03", b"R15", b"R0C", b"R02", b"R0B", b"R0E")]
    assert values == ["00000003", "0000000F", "00000003", "00000010", "00000000", "00000000"]


def test_a_reset_without_save_is_the_factory():
    bench = Bench(faults=faults(Fault("off", "qsb", 0.5, 0.6)))
    bench.do(FREE_X4, b"W15F", b"W0C0", b"S0E")
    bench.run(600)
    bench.rest = ""
    assert bench.lines(100) == []
    assert bench.do(b"R03", b"R15") == ["r 03 0000004F !", "r 15 0000000B !"]


def test_dtr_high_low_high_restarts_it():
    bench = Bench()
    bench.do(b"W15F")
    bench.device.drive_dtr(False, bench.now_ns)
    assert bench.run(200) == b""
    bench.device.drive_dtr(True, bench.now_ns)
    assert bench.run(110) == b"QSB-D  0E!\r\n"
    assert bench.do(b"R15") == ["r 15 0000000B !"]


@pytest.mark.parametrize(
    ("code", "baud_rate"),
    [(0, 9600), (1, 19200), (2, 38400), (3, 56000), (4, 115_200), (5, 128_000), (6, 230_400), (7, 256_000)],
)
def test_the_answer_to_a_baud_command_goes_at_the_old_rate(code, baud_rate):
    bench = Bench()
    assert bench.ask(b"W16%X0A\r" % code) == b"w 16 00000%X0A !\r\n" % code
    assert bench.device.line == LineFormat(baud_rate)
    if baud_rate != 230_400:
        assert b"r 15" not in bench.ask(b"R15\r")
        bench.wire.host = LineFormat(baud_rate)
        bench.ask(b"\r\r")  # ends what it heard of the wrong speed
    bench.wire.host = LineFormat(baud_rate)
    assert bench.ask(b"R15\r") == b"r 15 0000000B !\r\n"


def test_a_saved_baud_rate_is_the_one_after_a_reset():
    bench = Bench(faults=faults(Fault("reset", "qsb", 0.5)))
    bench.do(b"W1640A")
    bench.wire.host = LineFormat(115_200)
    bench.do(b"W163")
    assert b"QSB-D" in bench.run(1000)


def test_a_stuck_encoder_counts_no_more():
    bench = Bench(counts_s=10_000.0, faults=faults(Fault("stuck", "qsb", 0.3, 0.6)))
    bench.do(b"W15F", FREE_X4, b"W0C1")
    bench.send(b"S0E\r")
    bench.lines(160)
    assert len(set(data_of(bench.lines(250), "0E"))) == 1
    bench.lines(50)
    assert len(set(data_of(bench.lines(100), "0E"))) > 40
