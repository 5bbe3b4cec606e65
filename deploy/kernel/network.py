"""CAN interfaces without iproute2: made by rtnetlink, switched up and down by the interface flags."""

import fcntl
import os
import socket
import struct

_RTM_NEWLINK = 16
_NLM_F_REQUEST, _NLM_F_ACK, _NLM_F_EXCL, _NLM_F_CREATE = 0x001, 0x004, 0x200, 0x400
_IFLA_IFNAME, _IFLA_LINKINFO, _IFLA_INFO_KIND = 3, 18, 1
_IFF_UP = 0x1
_SIOCGIFFLAGS, _SIOCSIFFLAGS = 0x8913, 0x8914
_MESSAGE = struct.Struct("=IHHII")  # length, type, flags, sequence, port
_IFREQ = struct.Struct("=16sh14x")


def _attribute(kind: int, value: bytes) -> bytes:
    size = 4 + len(value)
    return struct.pack("=HH", size, kind) + value + bytes(-size % 4)


def add(name: str, kind: str = "vcan") -> None:
    """``ip link add NAME type KIND``. Raises OSError."""
    info = _attribute(_IFLA_LINKINFO, _attribute(_IFLA_INFO_KIND, kind.encode()))
    body = bytes(16) + _attribute(_IFLA_IFNAME, name.encode() + b"\0") + info
    flags = _NLM_F_REQUEST | _NLM_F_ACK | _NLM_F_CREATE | _NLM_F_EXCL
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as netlink:
        netlink.send(_MESSAGE.pack(_MESSAGE.size + len(body), _RTM_NEWLINK, flags, 1, 0) + body)
        (code,) = struct.unpack_from("=i", netlink.recv(4096), _MESSAGE.size)
    if code:
        raise OSError(-code, f"interface {name}: {os.strerror(-code)}")


def set_up(name: str, up: bool = True) -> None:
    """``ip link set NAME up`` or ``down``. Raises OSError."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        request = _IFREQ.pack(name.encode(), 0)
        _, flags = _IFREQ.unpack(fcntl.ioctl(control, _SIOCGIFFLAGS, request))
        flags = flags | _IFF_UP if up else flags & ~_IFF_UP
        fcntl.ioctl(control, _SIOCSIFFLAGS, _IFREQ.pack(name.encode(), flags))
