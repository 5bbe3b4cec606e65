"""heft's own serial frame for sensor nodes of one's own making: COBS, CRC-16, a descriptor every second.

``docs/node_frame.md`` is the format, ``deploy/node`` an encoder in C. Known warts: a node sends integers only (counts
and a scale); frames of one port are of one node.
"""

from drivers.node_frame.device import NodeFrame
from drivers.node_frame.frame import (
    Descriptor,
    FrameChannel,
    FrameStream,
    NodeFrameConfig,
    decode_descriptor,
    payload_dtype,
)

__all__ = [
    "Descriptor",
    "FrameChannel",
    "FrameStream",
    "NodeFrame",
    "NodeFrameConfig",
    "decode_descriptor",
    "payload_dtype",
]
