"""Is there a controller on this connection? Its software is asked for, and no output."""

from collections.abc import Callable, Iterator

from drivers.errors import FrameError
from drivers.ports import SerialPort, Station
from drivers.ur_rtde import packet

ANSWERED_S, STEP_S = 0.5, 0.01  # a controller answers within a few control cycles of 2 to 8 ms
JOINTS = range(1, 7)


def answering(port: SerialPort, wait: Callable[[float], object]) -> Iterator[Station]:
    """The joints of a controller that answers; none: nobody answers, or it is no RTDE.

    Raises:
        OSError: The connection fails.
    """
    stream = packet.PackageStream()
    try:
        version = _answer(port, wait, stream, packet.VERSION, packet.version_request())
        if version is None:
            return
        if not packet.decode_accepted(version):
            yield Station(0, "RTDE, protocol version 2 is refused: update the controller's software", is_read=False)
            return
        software = _answer(port, wait, stream, packet.URCONTROL, packet.package(packet.URCONTROL))
        told = "" if software is None else f", URControl {packet.decode_urcontrol(software)}"
    except FrameError:
        return
    for number in JOINTS:
        yield Station(number, f"UR controller{told}: number = {number}")


def _answer(
    port: SerialPort, wait: Callable[[float], object], stream: packet.PackageStream, kind: int, request: bytes
) -> bytes | None:
    """The payload of the answer to a request; None: it does not come."""
    port.write(request)
    for _ in range(round(ANSWERED_S / STEP_S)):
        wait(STEP_S)
        stream.receive(port.read(port.in_waiting))
        while (one := stream.take()) is not None:
            if one.kind == kind:
                return one.payload
    return None
