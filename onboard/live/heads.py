"""Heads of HTTP requests to a server on this computer: their fields, and the names that it goes by."""

import ipaddress
import socket
from urllib.parse import urlsplit

LOCAL = ("localhost", "127.0.0.1", "::1")


def fields(lines: list[str]) -> dict[str, list[str]]:
    """Values of each header field of a head's lines after the first, by name in lower case."""
    headers: dict[str, list[str]] = {}
    for line in lines:
        name, _, value = line.partition(":")
        headers.setdefault(name.strip().lower(), []).append(value.strip())
    return headers


def host_of(url: str) -> str | None:
    """The host that a URL names; None where it names none."""
    try:
        return urlsplit(url).hostname
    except ValueError:
        return None


def is_ours(host: str, *names: str) -> bool:
    """Whether ``host`` is this computer, one of ``names``, or a number, which is not asked of DNS."""
    if host in LOCAL or host in (*names, socket.gethostname().lower()):
        return True
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True
