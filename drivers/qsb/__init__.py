"""US Digital QSB-D/-S/-M quadrature-to-serial adapter: an LS7366R counter behind ASCII lines.

Source: "QSB Command List" v1.28. Known limits: the length of a timestamp tick is ambiguous in that document (1/512 s or
1.9 ms), so the raw tick is recorded and its length fitted from the sync marks; lines carry no checksum; CAPTURE is
streamed only when its value changes, and DIGIO only when the adapter sees the level change, so an edge is lost when the
joint is at rest and the pulse is shorter than the adapter's polling; whether the count survived a loss of power is not
reported.
"""

from drivers.qsb.device import Qsb
from drivers.qsb.edges import SyncEdges
from drivers.qsb.line import LineStream
from drivers.qsb.registers import QsbConfig, setup_commands

__all__ = ["LineStream", "Qsb", "QsbConfig", "SyncEdges", "setup_commands"]
