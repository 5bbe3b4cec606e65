"""US Digital QSB-D/-S/-M quadrature-to-serial adapter: an LS7366R counter behind ASCII lines.

Source: "QSB Command List" v1.28. Known warts: the length of a timestamp tick is ambiguous in that document (1/512 s or
1.9 ms), so the raw tick is recorded and its length fitted from the sync marks; lines carry no checksum; CAPTURE is only
streamed when its value changes, and DIGIO only when the adapter sees the level change, so that an edge is lost when the
joint stands still and the pulse is shorter than the adapter's polling; nothing tells whether the count ran through a
loss of power.
"""

from drivers.qsb.device import Qsb
from drivers.qsb.edges import SyncEdges
from drivers.qsb.line import Lines, LineStream, decode_lines
from drivers.qsb.registers import QsbConfig, setup_commands

__all__ = ["LineStream", "Lines", "Qsb", "QsbConfig", "SyncEdges", "decode_lines", "setup_commands"]
