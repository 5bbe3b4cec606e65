"""The clocks of a vehicle's channels, and the known delays of their samples."""

import tomllib
from urllib.parse import parse_qs, urlsplit

from onboard import config
from onboard.timebase import delays
from onboard.timebase.delays import Delay, on_wire_s
from onboard.timebase.timebase import (
    ChannelClock,
    FollowerChannel,
    FreeChannel,
    MarkedChannel,
    PolledChannel,
    PulseLine,
    RecordedChannel,
    SampledChannel,
    SyncChannel,
    Timebase,
)

CAN_NODES = (config.Cia402Device, config.Cia404Device, config.Cia406Device)
NIMU_TICK_NS = 2170.1
QSB_TICK_NS = 1.925e6  # 1.900 or 1.953 ms: the manual says both
UNTOLD_BAUD = 1e9  # of a line whose URL tells none: nothing is taken off for it


def timebase_of(vehicle: config.Vehicle) -> Timebase:
    """The clocks of a vehicle's channels."""
    clocks: dict[str, ChannelClock] = {}
    for name, device in vehicle.file.device.items():
        clocks |= _clocks(vehicle, name, device)
    return Timebase(clocks, pulse_line(vehicle))


def pulse_line(vehicle: config.Vehicle) -> PulseLine | None:
    """The line that marks come from: the coded one, or else somebody's PPS."""
    devices = vehicle.file.device.items()
    coded = [PulseLine(n, d.sync_period_ms * 1e6) for n, d in devices if isinstance(d, config.SyncPulseDevice)]
    plain = [PulseLine(n, d.period_ms * 1e6, coded=False) for n, d in devices if isinstance(d, config.PpsDevice)]
    return next(iter(coded + plain), None)


def known_delays(vehicle: config.Vehicle) -> list[Delay]:
    """Everything that is taken off the samples' times, channel by channel."""
    return [delay for name, device in vehicle.file.device.items() for delay in _delays(vehicle, name, device)]


def _clocks(vehicle: config.Vehicle, name: str, device: config.Device) -> dict[str, ChannelClock]:
    channels = list(device.channels(name))
    clock: ChannelClock
    match device:
        case config.Mpu6050Device():
            clock = SampledChannel(1e9 / device.sample_rate_hz)
        case config.NimuDevice():
            wire_ns = 1e9 * on_wire_s(delays.NIMU_PACKET_BYTES, _baud(vehicle, device.bus))
            latency_ns, sigma_ns = _latency_ns(device)
            clock = FreeChannel(NIMU_TICK_NS, wire_ns + latency_ns, sigma_ns)
        case config.QsbDevice():
            channels.remove(f"{name}_mark")
            wire_ns = 1e9 * on_wire_s(delays.QSB_LINE_BYTES, _baud(vehicle, device.bus))
            unmarked = FreeChannel(QSB_TICK_NS, wire_ns + 1e9 * delays.QSB_MEASUREMENT_S, QSB_TICK_NS / 12**0.5)
            marked = MarkedChannel(QSB_TICK_NS, f"{name}_mark", latches_counts=True)
            clock = unmarked if device.sync_edge == "none" else marked
        case config.NodeFrameDevice():
            channels.remove(f"{name}_mark")
            clock = MarkedChannel(1e9 / device.tick_hz, f"{name}_mark")
        case config.ModbusLoadCellDevice() | config.DscLoadCellDevice():
            question, answer = _exchange(name, device)
            baud = _baud(vehicle, device.bus)
            clock = PolledChannel(1e9 * on_wire_s(question, baud), 1e9 * on_wire_s(answer, baud))
            return dict.fromkeys(channels, clock)
        case config.CanopenSyncDevice():
            clock = SyncChannel(device.period_ms * 1e6, device.delay_ms * 1e6)
        case (
            config.Cia402Device()
            | config.Cia404Device()
            | config.Cia406Device()
            | config.CanopenObjectDevice(synchronous=True)
        ):
            return dict.fromkeys(channels, FollowerChannel(vehicle.sync_on(device.bus)[0]))
        case config.RecordedDevice():
            clock = RecordedChannel(0.0)
        case _:
            return {}
    first, *others = channels
    return {first: clock, **dict.fromkeys(others, FollowerChannel(first))}


def _delays(vehicle: config.Vehicle, name: str, device: config.Device) -> list[Delay]:
    channels = list(device.channels(name))
    clock = _clocks(vehicle, name, device).get(channels[0])
    found: list[Delay] = []
    match device, clock:
        case config.Mpu6050Device(), _:
            accel_s, gyro_s = delays.MPU6050_FILTER_DELAY_S[device.filter_code]
            why = f"low-pass filter, DLPF_CFG {device.filter_code}"
            found += [Delay(name, "gyro", gyro_s, 0.0, why), Delay(name, "accel", accel_s, 0.0, why)]
        case config.NimuDevice(), FreeChannel(_, delay_ns, sigma_ns):
            found.append(Delay(name, "", delay_ns * 1e-9, sigma_ns * 1e-9, "packet: wait for the line, and on it"))
            found.append(Delay(name, "gyro", device.gyro_delay_ms * 1e-3, 0.0, "its own filter"))
            found.append(Delay(name, "accel", device.accel_delay_ms * 1e-3, 0.0, "its own filter"))
        case config.QsbDevice(), FreeChannel(_, delay_ns, sigma_ns):
            found.append(Delay(name, "", delay_ns * 1e-9, sigma_ns * 1e-9, "measurement, and line on the wire"))
        case config.NodeFrameDevice(), _:
            parts = [(f"{name}_{c.name}", c) for c in device.channel if not isinstance(c, config.RecordChannel)]
            sigma_ms = {n: c.delay_sigma_ms for n, c in parts if isinstance(c, config.ForceChannel)}
            found += [
                Delay(n, "", c.delay_ms * 1e-3, sigma_ms.get(n, 0.0) * 1e-3, "filter of the node") for n, c in parts
            ]
        case config.LoadCellDevice(), _:
            cause = "filter of the load cell's amplifier"
            found.append(Delay(channels[0], "", device.delay_ms * 1e-3, device.delay_sigma_ms * 1e-3, cause))
    match clock:
        case PolledChannel(question_ns, answer_ns):
            cause = "answer on the wire; the sample lies between it and the question's end"
            found += [Delay(channel, "", answer_ns * 1e-9, 0.0, cause) for channel in channels]
            del question_ns
        case FollowerChannel(sync) if isinstance(device, CAN_NODES):
            delay_ms = vehicle.sync_on(device.bus)[1].delay_ms
            cause = f"SYNC frame of {sync} on the wire: nodes sample at its end"
            found += [Delay(channel, "", -delay_ms * 1e-3, 0.0, cause) for channel in channels]
    return [delay for delay in found if delay.delay_s or delay.sigma_s]


def _latency_ns(device: config.NimuDevice) -> tuple[float, float]:
    """From a sample to its packet, and sigma: some time before the next sample, where nobody has measured it."""
    if device.latency_ms is not None:
        return 1e6 * device.latency_ms, 1e6 * device.latency_sigma_ms
    period_ns = 1e9 / device.sample_rate_hz
    return 0.5 * period_ns, period_ns / 12**0.5


def _exchange(name: str, device: config.ModbusLoadCellDevice | config.DscLoadCellDevice) -> tuple[int, int]:
    """Bytes of a question and, at the least, of its answer."""
    if isinstance(device, config.ModbusLoadCellDevice):
        return delays.MODBUS_QUESTION_BYTES, delays.MODBUS_ANSWER_BYTES
    return len(f"!{device.station:03d}:{device.command}?\r"), delays.DSC_ANSWER_BYTES


def _baud(vehicle: config.Vehicle, bus: str) -> float:
    """By the file as it was written: a replay has no other, wherever the bus was in the flight."""
    url = tomllib.loads(vehicle.text)["bus"][bus]["url"]
    told = parse_qs(urlsplit(url).query).get("baud")
    return float(told[0]) if told else UNTOLD_BAUD
