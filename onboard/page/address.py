"""Where the page is served, and who may ask for it.

On the loopback interface anybody of this computer may. On another, of which the team says that it owns it, the paths
begin with a token that only the printed address has; so they do where something can be done through the page.
"""

import contextlib
import hmac
import ipaddress
import re
import secrets
import socket
from typing import NamedTuple

from onboard.live.heads import fields, host_of, is_ours

DEFAULT_HOST, DEFAULT_PORT = "127.0.0.1", 8787
LONGEST_REQUEST = 8192  # bytes
NOT_FOUND = "404 Not Found"
ACT, LONGEST_ACT = "act", 512  # path and bytes of what is asked of the flight


class PageAddress(NamedTuple):
    """Host and port to bind to. ``fixed``: the port was asked for, so another one will not do."""

    host: str
    port: int
    fixed: bool

    @property
    def is_local(self) -> bool:
        """Whether only this computer reaches it."""
        with contextlib.suppress(ValueError):
            return ipaddress.ip_address(self.host).is_loopback
        return self.host == "localhost"


def parse(text: str) -> PageAddress:
    """``HOST:PORT``, ``HOST``, ``:PORT`` or ``[IPv6]:PORT``; empty: :data:`DEFAULT_HOST` and a port that is free.

    Raises:
        ValueError: not an address.
    """
    match = re.fullmatch(r"(\[[0-9a-fA-F:.]+\]|[^:\[\]\s/]*)(?::(\d{1,5}))?", text)
    if match is None or (match[2] is not None and int(match[2]) > 65535):
        raise ValueError(f"--page-address {text}: write HOST:PORT, e.g. {DEFAULT_HOST}:{DEFAULT_PORT}")
    port = DEFAULT_PORT if match[2] is None else int(match[2])
    return PageAddress(match[1].strip("[]") or DEFAULT_HOST, port, fixed=match[2] is not None)


def token_for(address: PageAddress, *, acts: bool = False) -> str:
    """A new token of 128 bits; empty where only this computer reaches the page, and it can do nothing."""
    return "" if address.is_local and not acts else secrets.token_urlsafe(16)


def url(address: PageAddress, port: int, token: str) -> str:
    """What a browser opens; for an address that means all interfaces, that of the one that leads elsewhere."""
    host = address.host
    with contextlib.suppress(ValueError):
        if ipaddress.ip_address(host).is_unspecified:
            host = _outward(ipaddress.ip_address(host).version)
    return f"http://{f'[{host}]' if ':' in host else host}:{port}/{f'{token}/' if token else ''}"


def _outward(version: int) -> str:
    """This computer's address on the interface of its default route; its name where it has none. Sends nothing."""
    family, elsewhere = (socket.AF_INET, "192.0.2.1") if version == 4 else (socket.AF_INET6, "2001:db8::1")
    with contextlib.suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect((elsewhere, 9))
        return str(probe.getsockname()[0])
    return socket.gethostname()


class Request(NamedTuple):
    """Path and query of a request that may be answered; or the status that refuses it.

    ``body``: bytes of a POST's body; None of a GET.
    """

    path: str
    query: str = ""
    refused: str = ""
    body: int | None = None


def judge(head: bytes, address: PageAddress, token: str, *, acts: bool = False) -> Request:
    """Read the head of a request and say whether it may be answered.

    Refused are, by HTTP status: what is no GET (405), but a POST of ``act`` where the page has acts, which must be of
    the page itself (403), JSON (415) and short (413); without a token a Host that is a foreign name (403), which
    DNS can have point here; a page of another origin (403), by Origin or Sec-Fetch-Site; no token in the path (404).

    Args:
        head: of the request, to the empty line.
        address: that is served.
        token: that paths begin with, or empty.
        acts: whether something can be done through the page; only with a token.
    """
    first, *lines = head.decode("latin-1").split("\r\n")
    asked = re.fullmatch(r"([A-Z]+) (/[!-~]*) HTTP/1\.[01]", first)
    headers = fields(lines)
    if asked is None or len(headers.get("host", [])) != 1 or len(headers.get("origin", [])) > 1:
        return Request("", refused="400 Bad Request")
    if refused := _refusal(asked[1], headers, None if token else address, acts=acts and bool(token)):
        return Request("", refused=refused)
    body = int(headers["content-length"][0]) if asked[1] == "POST" else None
    path, _, query = asked[2].partition("?")
    if not token:
        return Request(path, query, "", body)
    given, separator, rest = path.removeprefix("/").partition("/")
    if not separator or not hmac.compare_digest(given.encode("latin-1"), token.encode()):
        return Request("", refused=NOT_FOUND)
    if body is not None and rest != ACT:
        return Request("", refused="405 Method Not Allowed")
    return Request(f"/{rest}", query, "", body)


def _refusal(method: str, headers: dict[str, list[str]], address: PageAddress | None, *, acts: bool) -> str:
    """The status, or nothing. Without an address any name will do: a page that has DNS point here has no token."""
    [named] = headers["host"]
    host = host_of(f"//{named}")
    if method != "GET" and not (acts and method == "POST"):
        return "405 Method Not Allowed"
    if host is None or not (address is None or is_ours(host, address.host.lower())):
        return "403 Forbidden Host"
    foreign = any(site in ("cross-site", "same-site") for site in headers.get("sec-fetch-site", []))
    navigates = headers.get("sec-fetch-mode", [""])[0] == "navigate"  # a link elsewhere may lead here
    if any(origin != f"http://{named}" for origin in headers.get("origin", [])) or (foreign and not navigates):
        return "403 Forbidden Origin"
    return _refusal_of_act(headers) if method == "POST" else ""


def _refusal_of_act(headers: dict[str, list[str]]) -> str:
    """A form of another page can send neither this type nor, in a browser, no Origin."""
    if not headers.get("origin") or headers.get("sec-fetch-site", ["same-origin"]) != ["same-origin"]:
        return "403 Forbidden Origin"
    if [kind.partition(";")[0].strip().lower() for kind in headers.get("content-type", [])] != ["application/json"]:
        return "415 Unsupported Media Type"
    length = headers.get("content-length", [])
    if len(length) != 1 or not re.fullmatch(r"[0-9]{1,9}", length[0]) or "transfer-encoding" in headers:
        return "411 Length Required"
    return "413 Content Too Large" if int(length[0]) > LONGEST_ACT else ""
