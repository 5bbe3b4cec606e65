"""What is on the buses of this computer: I2C chips by their identity, CANopen nodes, serial adapters, GPIO chips.

Nothing is set up and no state of a device is changed: chips are read at addresses of known kinds, and of every CANopen
node the objects 1000h and 1018h. Serial ports are listed and not opened: opening one resets many boards. One that is
named is asked: servos by a ping, Modbus stations by a read; and so are a
robot's controller on TCP, for its software, and a wrist sensor on UDP, for one record.
"""

import errno
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from drivers import transports
from drivers.canopen_pdo import frame
from drivers.canopen_pdo.sdo import SdoClient, Setup, read_unsigned
from drivers.errors import SdoAbortError
from drivers.i2c.bus import NOT_ACKNOWLEDGED, explain
from drivers.ports import CanPort, I2cPort, SerialPort
from drivers.transports.network import TCP_URLS, UDP_URLS, TcpPort, UdpPort
from drivers.transports.url import parse
from onboard.devices.base import BusDevice
from onboard.devices.buses import I2cDevice
from onboard.devices.registry import DEVICES

HEARD_S = 2.5  # heartbeats come every second, or two
ANSWERED_S = 0.2  # the read of an object
ASKED_EVERY_S = 2e-3  # a read and its answer take 0.5 ms at 500 kbit/s
STEP_S = 0.01
NODES = range(1, 128)
NETWORK = (TCP_URLS, TcpPort.open), (UDP_URLS, UdpPort.open)
CAN_LINK_TYPE = "280"  # ARPHRD_CAN in Linux' if_arp.h

Clock = Callable[[], int]
Wait = Callable[[float], object]


class DetectedDevice(NamedTuple):
    """One thing on a bus.

    Attributes:
        where: address or node number; empty where it is the bus itself.
        what: who it says it is.
        kind: of a device of a vehicle file that can be it; empty: none.
        number: I2C address, CANopen node number, or period of SYNC in us; 0 of others.
    """

    where: str
    what: str
    kind: str = ""
    number: int = 0


class ScannedBus(NamedTuple):
    """A bus, what is on it, and why it could not be looked at."""

    url: str
    found: tuple[DetectedDevice, ...] = ()
    problem: str = ""


def urls(dev: Path = Path("/dev"), net: Path = Path("/sys/class/net")) -> list[str]:
    """URLs of the I2C and CAN buses of this computer.

    Args:
        dev: directory of device nodes.
        net: directory of network interfaces.
    """
    i2c = sorted(dev.glob("i2c-*"), key=lambda path: (len(path.name), path.name))
    can = [link.name for link in sorted(net.glob("*")) if _text(link / "type") == CAN_LINK_TYPE]
    return [f"i2c://{path}" for path in i2c] + [f"can+socketcan://{name}?bitrate=500000" for name in can]


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        return ""


def scan(url: str, clock: Clock, wait: Wait) -> ScannedBus:
    """Look at an I2C or a CAN bus, or ask who is on a serial line or at an address of the network.

    Args:
        url: of the bus.
        clock: CLOCK_MONOTONIC, ns.
        wait: sleeps for so many seconds.

    Raises:
        DriverError: the URL is of none.
    """
    bus = parse(url, transports.I2C_URLS | transports.CAN_URLS | transports.SERIAL_URLS | TCP_URLS | UDP_URLS)
    try:
        for urls_of_it, opens in ((transports.SERIAL_URLS, transports.open_serial), *NETWORK):
            if bus.kind in urls_of_it:
                line = opens(url)
                try:
                    return ScannedBus(url, tuple(on_line(line, wait, bus.kind)))
                finally:
                    line.close()
        if bus.kind in transports.I2C_URLS:
            i2c = transports.open_i2c(url, clock)
            try:
                return ScannedBus(url, tuple(on_i2c(i2c)))
            finally:
                i2c.close()
        can = transports.open_can(url, clock)
        try:
            return ScannedBus(url, tuple(on_can(can, clock, wait)))
        finally:
            can.close()
    except OSError as error:
        return ScannedBus(url, problem=f"cannot be used: {error}")


def on_i2c(port: I2cPort) -> Iterable[DetectedDevice]:
    """Chips at the addresses that known kinds can have.

    Raises:
        OSError: the bus, not a device, fails.
    """
    kinds = [(k, s) for k, s in DEVICES.items() if issubclass(s, I2cDevice) and s.identify is not None]
    for address in sorted({address for _, section in kinds for address in section.addresses}):
        at = f"0x{address:02x}"
        others = ""
        for kind, section in kinds:
            if address not in section.addresses or section.identify is None:
                continue
            try:
                name = section.identify(port, address)
            except OSError as error:
                if error.errno in NOT_ACKNOWLEDGED:
                    break
                if error.errno in (errno.ENODEV, errno.ENOENT):
                    raise
                others = f"does not answer properly {explain(error)}"
                continue
            if name is not None:
                yield DetectedDevice(at, name, kind, address)
                break
            others = others or "answers, and is no chip that heft reads"
        else:
            if others:
                yield DetectedDevice(at, others)


def on_line(port: SerialPort, wait: Wait, scheme: str) -> Iterable[DetectedDevice]:
    """Stations that answer the question of a known kind on an open line, at its speed, or on an open connection.

    Args:
        port: the line or connection.
        wait: sleeps for so many seconds.
        scheme: of its URL: kinds on such a bus ask.

    Raises:
        OSError: the line fails.
    """
    for kind, section in DEVICES.items():
        if issubclass(section, BusDevice) and scheme in section.urls and section.answering is not None:
            for one in section.answering(port, wait):
                yield DetectedDevice(f"ID {one.number}", one.what, kind if one.is_read else "", one.number)


def on_can(port: CanPort, clock: Clock, wait: Wait) -> Iterable[DetectedDevice]:
    """SYNC, nodes with their device type and maker, and identifiers that are no CANopen node's.

    Raises:
        OSError: the bus is gone.
    """
    heard: Counter[int] = Counter()
    said: dict[int, bytes] = {}
    errors, states, syncs_ns = 0, dict[int, int](), list[int]()
    since_ns = clock()
    for _ in range(round(HEARD_S / STEP_S)):
        wait(STEP_S)
        for got in port.receive(0.0):
            errors += got.is_error
            if not got.is_error:
                heard[got.identifier] += 1
                said[got.identifier] = got.data
                syncs_ns += [got.host_ns] if got.identifier == frame.SYNC else []
                if len(got.data) == 1 and got.identifier - frame.HEARTBEAT in NODES:
                    states[got.identifier - frame.HEARTBEAT] = got.data[0] & 0x7F
    if errors:
        yield DetectedDevice("", f"{errors} error frames: check the bit rate and both terminations")
    heard_s = 1e-9 * (clock() - since_ns)
    if len(syncs_ns) > 1:
        period_us = 1e-3 * (syncs_ns[-1] - syncs_ns[0]) / (len(syncs_ns) - 1)
        yield DetectedDevice("080h", f"SYNC, every {1e-3 * period_us:.3g} ms", "canopen_sync", round(period_us))
    others = [
        DetectedDevice(f"ID {one.number}", one.what, kind, one.number)
        for kind, section in DEVICES.items()
        if issubclass(section, BusDevice) and section.heard is not None
        for one in section.heard(said)
    ]
    if others:  # what asks CANopen nodes could be a command to these
        yield from others
        return
    nodes = sorted(states.keys() | _answering(port, wait))
    for node in nodes:
        yield _node(port, clock, wait, node, states.get(node))
    known = {base + node for node in nodes for base in (*frame.TPDO[1:], frame.EMERGENCY, frame.HEARTBEAT)}
    for identifier in sorted(heard.keys() - known - {frame.SYNC, frame.NMT}):
        yield DetectedDevice(
            f"{identifier:03X}h", f"{heard[identifier] / heard_s:.3g} frames/s of no node that answers"
        )


def _answering(port: CanPort, wait: Wait) -> set[int]:
    """Nodes that answer a read of 1000h: one without a heartbeat is silent until it is asked."""
    answered = set()
    for node in NODES:
        port.send(frame.SDO_REQUEST + node, frame.encode_sdo_read(0x1000, 0))
        wait(ANSWERED_S if node == NODES[-1] else ASKED_EVERY_S)
        answered |= {got.identifier - frame.SDO_REPLY for got in port.receive(0.0) if not got.is_error}
    return answered & set(NODES)


def _node(port: CanPort, clock: Clock, wait: Wait, node: int, state: int | None) -> DetectedDevice:
    """Read its device type, vendor and product (CiA 301, 7.5.2.1 and 7.5.2.16)."""
    told: dict[tuple[int, int], int] = {}
    client = SdoClient(node, port.send)
    for entry in ((0x1000, 0), (0x1018, 1), (0x1018, 2)):
        client.begin(_reading(entry, told), clock())
        for _ in range(round(ANSWERED_S / STEP_S)):
            wait(STEP_S)
            for got in port.receive(0.0):
                if got.identifier == frame.SDO_REPLY + node and not got.is_error:
                    with suppress(SdoAbortError):  # it lacks the object
                        client.accept(got.data, got.host_ns)
            if not client.busy:
                break
    profile = told.get((0x1000, 0), 0) & 0xFFFF
    kind = f"cia{profile}" if f"cia{profile}" in DEVICES else ""
    said = f"CiA {profile}" if profile else "no device profile" if told else "does not answer"
    maker = [f"{name} {told[0x1018, n]:#x}" for n, name in ((1, "vendor"), (2, "product")) if (0x1018, n) in told]
    stated = {entry.value: entry.name.lower().replace("_", "-") for entry in frame.NmtState}
    stands = "no heartbeat" if state is None else stated.get(state, f"state {state}")
    return DetectedDevice(f"node {node}", ", ".join((said, *maker, stands)), kind, node)


def _reading(entry: tuple[int, int], told: dict[tuple[int, int], int]) -> Setup:
    told[entry] = yield from read_unsigned(*entry)
