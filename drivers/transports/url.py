"""Parses bus URLs and checks them against the known transports."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import parse_qsl, urlsplit

from drivers.errors import UrlError

SLCAN_BITRATES = {  # bit/s: the adapter's S command
    10_000: "S0",
    20_000: "S1",
    50_000: "S2",
    100_000: "S3",
    125_000: "S4",
    250_000: "S5",
    500_000: "S6",
    800_000: "S7",
    1_000_000: "S8",
}
COMPULSORY = {
    "serial": ("baud",),
    "gpio": ("line",),
    "gpio-out": ("line",),
    "gpio-pair": ("data", "clock"),
    "can+slcan": ("bitrate",),
    "can+python": ("bitrate",),
}
ONE_OF = {
    "can+slcan bitrate": tuple(map(str, SLCAN_BITRATES)),
    "parity": ("N", "E", "O"),
    "stop_bits": ("1", "2"),
    "timestamps": ("monotonic", "realtime"),
}
RANGES = {  # of an option that is a number
    "bitrate": (1, 1_000_000),  # ISO 11898-1
    "baud": (50, 12_000_000),  # the slowest of POSIX; the fastest USB adapters
    **dict.fromkeys(("line", "data", "clock"), (0, 2**32 - 1)),  # the kernel's GPIO_V2 offsets
    "speed": (1_000, 10_000_000),  # AS5048A
    "receive_buffer": (1, 2**31 - 1),  # an int of setsockopt
    "timeout_s": (0, 3600),
}
_MOST, _MOST_SHOWN, _MOST_OPTIONS = 4096, 200, 8  # characters (PATH_MAX), those in a message, options
_DIGITS, _SECONDS = re.compile(r"[0-9]{1,12}"), re.compile(r"[0-9]+(\.[0-9]*)?|\.[0-9]+")


@dataclass(frozen=True)
class BusUrl:
    """Parts of a bus URL.

    Attributes:
        text: The URL as it was given.
        kind: The scheme: ``i2c``, ``can+slcan``.
        host: Part between ``//`` and the path: an interface or channel name.
        path: The path: a device node or socket.
        options: The query, names and values.
    """

    text: str
    kind: str
    host: str
    path: str
    options: Mapping[str, str]

    def integer(self, name: str, default: int = 0) -> int:
        """An option that is a whole number; ``default`` where it is not given."""
        return int(self.options.get(name, default))

    def number(self, name: str, default: float) -> float:
        """An option that is a number; ``default`` where it is not given."""
        return float(self.options.get(name, default))


def parse(text: str, kinds: Mapping[str, tuple[str, ...]]) -> BusUrl:
    """Parse a bus URL and check it against the known transports.

    Args:
        text: The URL.
        kinds: Allowed schemes; for each ``"host"`` or ``"path"`` (the required part), then its options.

    Raises:
        UrlError: Unknown scheme or option, a missing part, or a value that an option cannot have. The message gives the
            correct form.
    """
    who = f"bus URL {text if len(text) <= _MOST_SHOWN else text[:_MOST_SHOWN] + '...'!r}"
    if not text.isprintable() or len(text) > _MOST:
        raise UrlError(f"{who} has a character that cannot be printed, or more than {_MOST}: write it anew")
    try:
        parts = urlsplit(text)
        given = parse_qsl(parts.query, keep_blank_values=True, max_num_fields=_MOST_OPTIONS)
    except ValueError as error:
        raise UrlError(f"{who} is none: {error}") from error
    if parts.scheme not in kinds:
        raise UrlError(f"{who} names no transport: begin it with any of {', '.join(kinds)} and '://'")
    needed, *allowed = kinds[parts.scheme]
    if needed == "path" and not parts.path.startswith("/"):
        raise UrlError(f"{who} has no path: write {parts.scheme}:///dev/... with three slashes")
    if needed == "path" and parts.netloc:
        raise UrlError(f"{who} has {parts.netloc!r} before the path: write {parts.scheme}:///dev/...")
    if needed == "host" and (not parts.netloc or parts.path.strip("/")):
        raise UrlError(f"{who} needs a name and no path: write {parts.scheme}://NAME")
    if parts.scheme == "can+python" and not all(parts.path.strip("/").partition("/")):
        raise UrlError(f"{who} needs an interface and a channel: can+python:///pcan/PCAN_USBBUS1")
    if "#" in text:
        raise UrlError(f"{who} has a '#', after which nothing is read: take it out")
    return BusUrl(text, parts.scheme, parts.netloc, parts.path, _options(who, parts.scheme, given, allowed))


def _options(who: str, scheme: str, given: list[tuple[str, str]], allowed: list[str]) -> dict[str, str]:
    """The options of a URL, each known, given once, and of a value that it can have."""
    options = dict(given)
    if len(options) < len(given):
        raise UrlError(f"{who} gives an option twice: take either out")
    if unknown := sorted(set(options) - set(allowed)):
        known = f"use only {', '.join(allowed)}" if allowed else "it takes none"
        raise UrlError(f"{who} has unknown options {', '.join(unknown)}: {known}")
    for needed in COMPULSORY.get(scheme, ()):
        if needed not in options:
            raise UrlError(f"{who} lacks {needed}: add '?{needed}=...'")
    for name, value in options.items():
        if why := _wrong(scheme, name, value):
            raise UrlError(f"{who}: {name}={value} {why}")
    return options


def _wrong(scheme: str, name: str, value: str) -> str:
    """Why an option cannot have this value, with the remedy; "" where it can."""
    words = ONE_OF.get(f"{scheme} {name}", ONE_OF.get(name))
    if words is not None:
        return "" if value in words else f"is none that it can have: use any of {', '.join(words)}"
    if name == "second":
        return "" if value.startswith("/") else "is no path: write /dev/..."
    low, high = RANGES[name]
    if not (_SECONDS if name == "timeout_s" else _DIGITS).fullmatch(value):
        return "is not a number: give digits" if name == "timeout_s" else "is not a whole number: give digits"
    return "" if low <= float(value) <= high else f"is not within {low:g} and {high:.12g}: correct it"
