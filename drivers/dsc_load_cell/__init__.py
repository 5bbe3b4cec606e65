"""Mantracourt DSC/DCell load cell digitiser, ASCII protocol.

Source: DSC user manual (manualslib 1483307 pages 48-54; 3115456 page 72). Known limits: no checksum, so a corrupted
digit is not detected (a wrong length is); the converter runs on its own clock.
"""

from drivers.dsc_load_cell.device import DscLoadCell
from drivers.dsc_load_cell.message import DscLoadCellConfig, DscReply, decode_number, read_command

__all__ = ["DscLoadCell", "DscLoadCellConfig", "DscReply", "decode_number", "read_command"]
