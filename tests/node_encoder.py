"""``deploy/node/heft_node.c`` as a shared library, for tests of who reads it and of who speaks like it."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wshadow"]
needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler: install gcc")


class CChannel(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_char_p),
        ("unit", ctypes.c_char_p),
        ("type", ctypes.c_uint8),
        ("flags", ctypes.c_uint8),
        ("mantissa", ctypes.c_int32),
        ("exponent", ctypes.c_int8),
    )


class CNode(ctypes.Structure):
    _fields_ = (
        ("channels", ctypes.POINTER(CChannel)),
        ("channel_count", ctypes.c_uint8),
        ("id", ctypes.c_uint8),
        ("tick_hz", ctypes.c_uint32),
        ("boot", ctypes.c_uint32),
        ("sequence", ctypes.c_uint32),
        ("pulse", ctypes.c_uint32),
        ("pulse_tick", ctypes.c_uint32),
        ("schema", ctypes.c_uint16),
    )


class CEncoder:
    """heft_node.c as a shared library; behaves as ``NodeModel``."""

    def __init__(self, library, channels, node=1, tick_hz=1_000_000, boot=0) -> None:
        self.library = library
        self.channels = (CChannel * max(1, len(channels)))(
            *((n.encode(), u.encode(), *rest) for n, u, *rest in channels)
        )
        self.count = len(channels)
        self.node = CNode()
        library.heft_node_init(ctypes.byref(self.node), node, self.channels, self.count, tick_hz, boot)

    def _call(self, function, capacity, *arguments) -> bytes:
        out = (ctypes.c_uint8 * (capacity + 8))(*[0xAA] * (capacity + 8))
        length = function(ctypes.byref(self.node), *arguments, out, capacity)
        assert bytes(out[capacity:]) == b"\xaa" * 8, "wrote beyond the buffer"
        return bytes(out[:length])

    def descriptor(self, tick, capacity=4096) -> bytes:
        return self._call(self.library.heft_node_descriptor, capacity, tick)

    def edge(self, tick) -> None:
        self.library.heft_node_pulse(ctypes.byref(self.node), tick)

    def data(self, tick, *values, status=0, capacity=4096) -> bytes:
        numbers = (ctypes.c_int64 * max(1, len(values)))(*values)
        return self._call(self.library.heft_node_data, capacity, tick, status, numbers)


def built(directory: Path) -> ctypes.CDLL:
    """Compile it; undefined behaviour traps."""
    if shutil.which("cc") is None:
        pytest.skip("no C compiler: install gcc")
    path = directory / "libheft_node.so"
    source = ROOT / "deploy" / "node" / "heft_node.c"
    traps = ["-fsanitize=undefined", "-fsanitize-undefined-trap-on-error"]
    subprocess.run(["cc", *STRICT, *traps, "-O2", "-shared", "-fPIC", str(source), "-o", str(path)], check=True)
    library = ctypes.CDLL(str(path))
    node, out, u64, size = ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_size_t
    u8, u32 = ctypes.c_uint8, ctypes.c_uint32
    library.heft_node_init.argtypes = [node, u8, ctypes.c_void_p, u8, u32, u32]
    library.heft_node_init.restype = None
    library.heft_node_pulse.argtypes = [node, u64]
    library.heft_node_pulse.restype = None
    library.heft_node_descriptor.argtypes = [node, u64, out, size]
    library.heft_node_descriptor.restype = size
    library.heft_node_data.argtypes = [node, u64, u8, ctypes.c_void_p, out, size]
    library.heft_node_data.restype = size
    return library
