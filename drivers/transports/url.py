"""Parses bus URLs and checks them against the known transports."""

from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import parse_qsl, urlsplit

from drivers.errors import UrlError


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

    def integer(self, name: str, default: int | None = None) -> int:
        """An option that is a whole number.

        Args:
            name: The option.
            default: Its value when it is not given; None makes it compulsory.

        Raises:
            UrlError: It is missing or not a whole number.
        """
        text = self.options.get(name)
        if text is None:
            if default is None:
                raise UrlError(f"bus URL {self.text!r} lacks {name}: add '?{name}=...'")
            return default
        try:
            return int(text, 0)
        except ValueError as error:
            raise UrlError(f"bus URL {self.text!r}: {name}={text} is not a whole number: give digits") from error

    def number(self, name: str, default: float) -> float:
        """An option that is a number.

        Raises:
            UrlError: It is not a number.
        """
        text = self.options.get(name)
        try:
            return default if text is None else float(text)
        except ValueError as error:
            raise UrlError(f"bus URL {self.text!r}: {name}={text} is not a number: give digits") from error


def parse(text: str, kinds: Mapping[str, tuple[str, ...]]) -> BusUrl:
    """Parse a bus URL and check it against the known transports.

    Args:
        text: The URL.
        kinds: Allowed schemes; for each ``"host"`` or ``"path"`` (the required part), then its options.

    Raises:
        UrlError: Unknown scheme or option, or a missing part. The message gives the correct form.
    """
    try:
        parts = urlsplit(text)
    except ValueError as error:
        raise UrlError(f"bus URL {text!r} is none: {error}") from error
    if parts.scheme not in kinds:
        raise UrlError(f"bus URL {text!r} names no transport: begin it with one of {', '.join(kinds)} and '://'")
    needed, *allowed = kinds[parts.scheme]
    if needed == "path" and not parts.path.startswith("/"):
        raise UrlError(f"bus URL {text!r} has no path: write {parts.scheme}:///dev/... with three slashes")
    if needed == "path" and parts.netloc:
        raise UrlError(f"bus URL {text!r} has {parts.netloc!r} before the path: write {parts.scheme}:///dev/...")
    if needed == "host" and (not parts.netloc or parts.path.strip("/")):
        raise UrlError(f"bus URL {text!r} needs one name and no path: write {parts.scheme}://NAME")
    options = dict(parse_qsl(parts.query, keep_blank_values=True))
    unknown = sorted(set(options) - set(allowed))
    if unknown:
        known = f"use only {', '.join(allowed)}" if allowed else "it takes none"
        raise UrlError(f"bus URL {text!r} has unknown options {', '.join(unknown)}: {known}")
    return BusUrl(text, parts.scheme, parts.netloc, parts.path, options)
