"""Is there a sensor at this address? One record is asked for; a stream that goes to somebody else would end by it."""

from collections.abc import Callable, Iterator

from drivers.errors import FrameError
from drivers.net_ft.record import START, RecordStream, request
from drivers.ports import SerialPort, Station

ANSWERED_S, STEP_S = 0.5, 0.01
COMPONENTS = ("force along x", "force along y", "force along z", "moment about x", "moment about y", "moment about z")


def answering(port: SerialPort, wait: Callable[[float], object]) -> Iterator[Station]:
    """The components of a sensor that answers; none: nobody answers, or it sends something else.

    Raises:
        OSError: The peer refuses.
    """
    stream = RecordStream()
    port.write(request(START, records=1))
    for _ in range(round(ANSWERED_S / STEP_S)):
        wait(STEP_S)
        waiting = port.in_waiting
        stream.receive(port.read(waiting) if waiting else b"")
        try:
            if stream.take() is not None:
                for number, what in enumerate(COMPONENTS, 1):
                    yield Station(number, f'RDT sensor, {what}: component = {number}; of OnRobot: kind = "onrobot_hex"')
                return
        except FrameError:
            return
