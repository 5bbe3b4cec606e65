"""What a target raises, grouped by place, shortened and saved."""

import hashlib
import signal
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "bench" / "fuzz_findings"
OURS = (str(ROOT / "drivers") + "/", str(ROOT / "onboard") + "/")
HANG_S = 10.0
MOST_MB = 1000  # more than before it, at any time of a call
SHORTENINGS = 2000  # executions spent to shorten a finding

Call = Callable[[bytes], None]


class Hang(BaseException):
    """A call took longer than ``HANG_S``. No Exception, so that no ``except`` in a decoder takes it."""


class Greedy(BaseException):
    """A call took more than ``MOST_MB``."""


class Result(NamedTuple):
    """What came of one decoder.

    Attributes:
        executions: Calls of the target.
        seconds: They took.
        paths: Inputs kept, each of which reached what no other had.
        files: Of those that raised.
    """

    executions: int
    seconds: float
    paths: int
    files: list[Path]


class FuzzFindings:
    """Runs a target and keeps what it raises, one input for a place.

    Args:
        call: The target.
        folder: Where they go, made at the first of them; None: they are not written.
    """

    def __init__(self, call: Call, folder: Path | None) -> None:
        self.files: dict[str, Path] = {}  # by place
        self.places: dict[str, bytes] = {}
        self._call = call
        self._folder = folder

    def run(self, data: bytes) -> None:
        """Call the target, with what it raises taken note of."""
        error = raised(self._call, data)
        if error is None or place_of(error) in self.places:
            return
        place = place_of(error)
        self.places[place] = data
        short = shortened(self._call, data, place)
        self.places[place] = short
        self._save(place, short)

    def _save(self, place: str, data: bytes) -> None:
        if self._folder is None:
            return
        self._folder.mkdir(parents=True, exist_ok=True)
        (self._folder.parent / ".gitignore").write_text("*\n", encoding="ascii")
        file = self._folder / f"{hashlib.sha256(data).hexdigest()[:16]}.bin"
        file.write_bytes(data)
        error = raised(self._call, data)
        text = "".join(traceback.format_exception(error)) if error else "it did not come again\n"
        file.with_suffix(".txt").write_text(f"{data.hex(' ')}\n\n{text}", encoding="utf-8")
        self.files[place] = file


def raised(call: Call, data: bytes) -> BaseException | None:
    """What the target raises; None when it takes the input."""
    try:
        before = peak_mb(anew=True)
        with alarm(HANG_S):
            call(data)
        if (more := peak_mb() - before) > MOST_MB:
            raise Greedy(f"{more} MB")
    except (Exception, Hang, Greedy) as error:  # noqa: BLE001 - whatever it is, it is what we look for
        return error
    return None


def peak_mb(*, anew: bool = False) -> int:
    """Largest memory of this process; ``anew``: from now on. 0 where the system does not tell."""
    with suppress(OSError):
        if anew:
            Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
        status = Path("/proc/self/status").read_text(encoding="ascii")
        return int(status.partition("VmHWM:")[2].split()[0]) // 1024
    return 0


@contextmanager
def alarm(seconds: float) -> Iterator[None]:
    """Raise ``Hang`` in the main thread after so long."""

    def ring(number: int, frame: FrameType | None) -> None:
        raise Hang(f"no end after {seconds} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def place_of(error: BaseException) -> str:
    """Kind of the exception, and the last line of ours on its way (for a broken law: of the target)."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if frame.filename.startswith(OURS)] or frames
    return f"{type(error).__name__} {ours[-1].filename}:{ours[-1].lineno}"


def shortened(call: Call, data: bytes, place: str) -> bytes:
    """The input with every stretch left out that the finding does not need."""
    left = SHORTENINGS
    size = max(len(data) // 2, 1)
    while size and left > 0:
        at, before = 0, len(data)
        while at < len(data) and left > 0:
            shorter = data[:at] + data[at + size :]
            error = raised(call, shorter)
            left -= 1
            if error is not None and place_of(error) == place:
                data = shorter
            else:
                at += size
        if len(data) == before:  # else what was left out may let more go
            size //= 2
    return data
