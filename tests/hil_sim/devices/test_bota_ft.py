"""The simulated wrist sensor of Bota Systems byte for byte, by another's checksum; the maker's own driver reads it."""

import itertools
import struct

import pytest
from fastcrc.crc16 import ibm_sdlc

from hil_sim.buses.serial_bus import SerialBus
from hil_sim.buses.serial_port import VirtualSerial
from hil_sim.devices.serial_wire import LineFormat
from hil_sim.devices.wrist.bota_ft import BotaTwin
from hil_sim.faults import Fault, FaultError, FaultPlan
from onboard.cli import main
from tests.flight.check.test_desk import served
from tests.hil_sim.devices.serial_bench import Line
from tests.hil_sim.devices.twin_bench import MS, START_NS, Analog, RateClock

FAST = LineFormat(460_800)


def sensor(*faults, fz=2.0, component=2, most=100.0, **options):
    """A sensor that feels a force along z, a number or a function of mission time."""
    felt = Analog(fz if callable(fz) else lambda _: fz)
    plan = FaultPlan([Fault(*fault) for fault in faults], START_NS)
    options = {"jitter_ns": 0, "faults": plan.of("wrist"), **options}
    return BotaTwin({component: (felt, most)}, RateClock(), START_NS, **options)


def bench(*faults, **options):
    """It on its line, half a second after power-up."""
    line = Line(sensor(*faults, **options), FAST)
    line.run(499)
    assert line.ask(b"", 2) == b"App Init\r\n"
    return line


def frames(data):
    """Status, wrench, time and temperature of each frame, as the maker's example unpacks them."""
    found = []
    while len(data) >= 37:
        assert data[0] == 0xAA
        content, (crc,) = data[1:35], struct.unpack("<H", data[35:37])
        assert crc == ibm_sdlc(content)
        status, *wrench, time_us, warm = struct.unpack("<H6fIf", content)
        found.append((status, wrench, time_us, warm))
        data = data[37:]
    return found


def run_of(line, sinc, ms):
    """Set it up by the maker's commands; frames of the time after."""
    assert line.ask(b"C", 40)[-9:] == b"r,0,C,0\r\n"
    assert line.ask(b"c,0,1,0,4", 5) == b"r,0,c,0\r\n"
    assert line.ask(b"f,%d,0,0,1" % sinc, 5) == b"r,0,f,0\r\n"
    assert line.ask(b"R", 2) == b"r,0,R,0\r\n"
    return frames(line.ask(b"", ms))


def test_it_runs_as_saved_until_it_is_set_up():
    line = bench()
    (first, *_, last) = frames(line.ask(b"", 100))
    assert (first[0], first[1]) == (0, [0, 0, 2.0, 0, 0, 0])
    assert last[2] - first[2] == 80_000  # 100 a second
    assert line.device.produced == 0  # nobody asked for these


@pytest.mark.parametrize(("sinc", "rate_hz"), [(64, 800), (128, 400), (512, 100), (2048, 25)])
def test_it_is_set_up_by_the_commands_of_the_maker_s_example(sinc, rate_hz):
    line = bench()
    heard = run_of(line, sinc, 1000)
    assert abs(len(heard) - rate_hz) <= 1
    assert {b[2] - a[2] for a, b in itertools.pairwise(heard)} == {1_000_000 // rate_hz}
    assert abs(line.device.produced - len(heard)) <= 1


def test_its_time_is_that_of_the_sample_by_its_own_clock():
    line = bench(fz=lambda time_s: time_s)
    for _, wrench, time_us, warm in run_of(line, 128, 50):
        assert wrench[2] == pytest.approx(1e-6 * time_us, abs=2e-6)
        assert warm == pytest.approx(31.0, abs=0.1)


@pytest.mark.parametrize(
    ("command", "code"),
    [
        *((b"c,0,1,0,4", 0), (b"c,1,0,0,4", 0), (b"c,2,1,0,4", 1), (b"c,0,1,1,4", 1), (b"c,0,1,0,3", 1)),
        *((b"f,64,0,0,1", 0), (b"f,2048,0,0,0", 0), (b"f,63,0,0,1", 1), (b"f,2049,0,0,1", 1), (b"f,64,1,0,1", 1)),
        *((b"f,64,0,0\n", 1), (b"s", 0), (b"x\r", 1), (b"c,0,1,f,64,0,0,1", 0), (b"f,512,0,0,1\n", 0)),
    ],
)
def test_a_command_is_answered_with_its_code(command, code):
    line = bench()
    line.ask(b"C\n", 40)
    letter = command[:1] if command.count(b"f") == 0 else b"f"
    assert line.ask(command, 10) == b"r,0,%b,%d\r\n" % (letter, code)


def test_in_run_mode_it_obeys_one_command_only_and_raw_numbers_are_told():
    line = bench()
    assert all(status == 0 for status, *_ in frames(line.ask(b"c,0,0,0,4f,64,0,0,1sRx\n", 50)))
    line.ask(b"C", 40)
    line.ask(b"c,0,0,0,4", 5)
    line.ask(b"s", 5)
    line.ask(b"R", 2)
    assert {status for status, *_ in frames(line.ask(b"", 50))} == {8}


def test_beyond_its_range_it_says_so_and_stays_at_its_end():
    heard = run_of(bench(fz=-150.0), 64, 10)
    assert {(status, wrench[2]) for status, wrench, *_ in heard} == {(2, -100.0)}


def test_without_power_it_forgets_what_is_not_saved_and_its_time_begins_again():
    line = bench(("off", "wrist", 1.0, 1.2))
    heard = run_of(line, 64, 600)
    assert line.ask(b"", 540) == b""
    assert line.ask(b"", 50).startswith(b"App Init\r\n")
    (first, second, *_) = frames(line.ask(b"", 100)[-37 * 5 :])
    assert second[2] - first[2] == 10_000
    assert first[2] < heard[-1][2]


def test_several_tables_are_one_sensor_with_the_faults_of_each():
    adapter = VirtualSerial("/dev/hil-wrist")
    bus, now_ns = SerialBus(adapter), START_NS
    parts = [sensor(fz=1.0), sensor(("silent", "wrist", 1.2, 1.3), fz=-4.0, component=5)]
    parts.append(sensor(("off", "wrist", 1.5, 1.6), fz=7.0, component=0))
    for part in parts:
        bus.add(part, lambda part=part: part.produced, lambda data: 37 * (len(data) == 37))
    bus.advance(START_NS)
    port = adapter.open(FAST)

    def run(ms, said=b""):
        nonlocal now_ns
        port.write(said)
        for _ in range(ms):
            now_ns += MS
            bus.advance(now_ns)
        return port.read(1_000_000)

    run(600)
    assert run(40, b"C")[-9:] == b"r,0,C,0\r\n"
    assert run(2, b"R") == b"r,0,R,0\r\n"
    heard = frames(run(857))
    assert {tuple(wrench) for _, wrench, *_ in heard} == {(7.0, 0.0, 1.0, 0.0, 0.0, -4.0)}
    assert len(heard) == 85 - 10  # it was silent for a tenth of a second
    assert bus.samples == parts[0].produced == parts[2].produced == 85
    assert run(600) == b""
    assert b"App Init" in run(200)


def test_a_fault_or_a_speed_that_it_cannot_have_is_refused():
    with pytest.raises(FaultError, match="nack"):
        sensor(("nack", "wrist", 1.0, 2.0))


@pytest.mark.realtime
def test_the_maker_s_own_driver_sets_it_up_and_reads_it(tmp_path):
    """Package ``bota-driver`` 1.1.16; it holds the interpreter, so that the sensor is served by another process."""
    maker = pytest.importorskip("bota_driver", reason="pip install bota-driver==1.1.16 (10 MB)")
    assert main(["init", str(tmp_path / "mine"), "--base", "fixed", "--joints", "2", "--load-cell", "bota_ft"]) == 0
    asked = maker.BotaDriverConfig()
    asked.product_name, asked.serial_number = "BFT-SENS-SER-M8", "SN000853"
    asked.communication_interface_name = "Bota_Binary_gen0"
    operation = maker.Gen0SensorOperationConfig()
    operation.sinc_length = 256
    asked.gen0_sensor_operation_params = operation
    line, options = maker.BotaBinaryCommunicationInterfaceConfig(), maker.DriverOperationConfig()
    options.skip_metadata_reading = True  # of its product, which no source describes
    asked.driver_operation_params = options
    with served(str(tmp_path / "mine" / "vehicle.toml"), tmp_path / "wires") as urls:
        line.com_port, line.baudrate = urls["tty_wrist"].removeprefix("serial://").partition("?")[0], 460_800
        asked.binary_communication_interface_params = line
        driver = maker.BotaDriver(asked)
        assert driver.configure()
        assert driver.activate()
        heard = [driver.read_frame_blocking() for _ in range(200)]
        assert driver.deactivate()
        assert driver.shutdown()
    steps = {b.timestamp - a.timestamp for a, b in itertools.pairwise(heard)}
    assert steps - {0} == {5000}  # it may hand over a frame twice
    assert sum(value * value for value in heard[-1].force) ** 0.5 > 5.0  # the payload's weight
