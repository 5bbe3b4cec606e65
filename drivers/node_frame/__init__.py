"""heft's serial frame for custom sensor nodes: COBS, CRC-16, a descriptor every second.

``docs/node_frame.md`` defines the format, ``deploy/node`` has an encoder in C. Known limits: a node sends integers only
(counts and a scale); one node per port.
"""

from drivers.node_frame.device import NodeFrame
from drivers.node_frame.frame import FrameChannel, FrameStream, NodeFrameConfig, decode_descriptor, payload_dtype

__all__ = ["FrameChannel", "FrameStream", "NodeFrame", "NodeFrameConfig", "decode_descriptor", "payload_dtype"]
