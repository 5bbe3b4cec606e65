"""A CAN bus in the flight computer's own process: python-can's ``virtual`` interface with an adapter to be pulled out.

While ``install_can`` is in force, ``can.Bus(interface="virtual")`` makes a ``PulledBus``.
"""

import contextlib
import errno
import queue
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from typing import Any, Final

import can
from can.interfaces import BACKENDS
from can.interfaces.virtual import VirtualBus

from drivers.ports import CanFrame
from hil_sim.buses.media import CanBus
from hil_sim.buses.ports import Port

_looks: Final[dict[str, Callable[[], None]]] = {}  # by channel: advances its twins, so that all frames due are sent
_away: set[str] = set()  # channels whose adapter is pulled out


class _Frames(queue.Queue[Any]):
    """The queue of a bus that takes a twin's frames as they are."""


class PulledBus(VirtualBus):
    """A virtual bus that raises ENODEV once its adapter was pulled, also after another one was put in.

    What a twin sends waits as it is: messages are made for a reader that asks for them, as ``can.BusABC`` has them.
    """

    def __init__(self, channel: str = "channel-0", **options: Any) -> None:
        self._look = _looks.get(channel, lambda: None)
        self._look()
        if channel in _away:
            raise can.CanInitializationError(f"no adapter {channel}", error_code=errno.ENODEV)
        super().__init__(channel, **options)
        plain, self.queue = self.queue, _Frames(self.queue.maxsize)
        self.channel[self.channel.index(plain)] = self.queue

    def frames(self) -> list[CanFrame] | None:
        """All that waits, stamped as it was sent; None where not all of it are frames of a twin, or some are filtered.

        Raises:
            can.CanOperationError: the adapter was pulled out.
        """
        self._check_if_open()
        waiting = self.queue.queue
        if self._filters is not None or not all(type(one) is CanFrame for one in waiting):
            return None
        frames = list(waiting)
        waiting.clear()
        return frames

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """See ``can.BusABC``; without its clock and filters where nothing is waited for and nothing filtered.

        Where twins are on the channel, all that is due has been sent before: time goes on outside of this call only.
        """
        waits = timeout != 0 and self.channel_id not in _looks
        if waits or self._filters is not None:
            return super().recv(timeout)
        self._check_if_open()
        return self._message(self.queue.queue.popleft()) if self.queue.queue else None

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        waiting, filtered = super()._recv_internal(timeout)
        return self._message(waiting), filtered

    def _message(self, waiting: can.Message | CanFrame | None) -> can.Message | None:
        return _message(waiting, self.channel_id) if isinstance(waiting, CanFrame) else waiting

    def shutdown(self) -> None:
        """See ``can.BusABC``; also of one that was pulled."""
        self._look()
        if self.queue not in self.channel:
            self.channel.append(self.queue)
        super().shutdown()

    def _check_if_open(self) -> None:
        self._look()
        super()._check_if_open()
        if self.queue not in self.channel:
            raise can.CanOperationError(f"adapter {self.channel_id} was pulled out", error_code=errno.ENODEV)


@contextlib.contextmanager
def install_can() -> Iterator[None]:
    """While in force, adapters of virtual buses that are opened can be pulled out."""
    before = BACKENDS["virtual"]
    BACKENDS["virtual"] = (__name__, PulledBus.__name__)
    try:
        yield
    finally:
        BACKENDS["virtual"] = before


class VirtualCan:
    """The far end of a python-can ``virtual`` channel; ``timestamp`` is ``CLOCK_MONOTONIC`` in seconds.

    Args:
        channel: Its name in this process.
    """

    def __init__(self, channel: str) -> None:
        self._channel = channel
        self._bus = VirtualBus(channel, preserve_timestamps=True)

    def tell_looks(self, look: Callable[[], None]) -> None:
        """Let buses of the channel that are opened from now on call ``look`` before they do anything."""
        _looks[self._channel] = look

    @property
    def listening(self) -> bool:
        """Whether a bus is open on the channel."""
        return len(self._bus.channel) > 1

    def take(self) -> list[tuple[int, bytes | int]]:
        """Frames with 11-bit identifiers sent by others on the channel; see ``CanLink``."""
        frames: list[tuple[int, bytes | int]] = []
        if not self._bus.queue.queue:
            return frames
        while (message := self._bus.recv(0)) is not None:
            if not (message.is_extended_id or message.is_error_frame):
                content = message.dlc if message.is_remote_frame else bytes(message.data)
                frames.append((message.arbitration_id, content))
        return frames

    def give(self, frames: Sequence[CanFrame]) -> None:
        """Send frames with their stamps: what ``VirtualBus.send`` does, but for its deep copy of each message."""
        own = self._bus.queue
        for each in self._bus.channel:
            if each is not own:
                is_ours = isinstance(each, _Frames)
                given = frames if is_ours else [_message(frame, self._channel) for frame in frames]
                with each.not_empty:
                    each.queue.extend(given)
                    each.not_empty.notify(len(given))

    def give_error(self, end_ns: int, classes: int) -> None:
        """Send an error frame."""
        self._bus.send(can.Message(timestamp=end_ns * 1e-9, arbitration_id=classes, is_error_frame=True, data=bytes(8)))

    def unplug(self) -> None:
        """The adapter is pulled out: what is open on the channel is dead, and nothing can be opened."""
        _away.add(self._channel)
        self._bus.channel[:] = [self._bus.queue]

    def plug(self) -> None:
        """The adapter is back."""
        _away.discard(self._channel)

    def close(self) -> None:
        """Leave the channel."""
        _looks.pop(self._channel, None)
        _away.discard(self._channel)
        self._bus.shutdown()


def _message(frame: CanFrame, channel: Any) -> can.Message:
    """A frame as python-can has it."""
    host_ns, identifier, data, _ = frame
    return can.Message(host_ns * 1e-9, identifier, is_extended_id=False, data=data, channel=channel)


class VirtualCanPort(Port):
    """A bus in this process, at ``can+virtual://CHANNEL``.

    Args:
        channel: its name.
        bit_rate: bit/s.
        seed: of the stamp jitter.
    """

    def __init__(self, channel: str, bit_rate: int, seed: int) -> None:
        self._link = VirtualCan(channel)
        self._installed = ExitStack()
        self._installed.enter_context(install_can())
        bus = CanBus(self._link, bit_rate, seed)
        self._link.tell_looks(bus.look)
        super().__init__(bus, f"can+virtual://{channel}?timestamps=monotonic")

    def close(self) -> None:
        """See ``Port``."""
        self._installed.close()
        self._link.close()
