"""Mantracourt DSC/DCell load cell digitiser, ASCII protocol.

Source: DSC user manual (manualslib 1483307 pages 48-54; 3115456 page 72). Known warts: no checksum, so a digit that
turned into another passes (an answer of another length does not); the converter runs on its own clock.
"""

from drivers.dsc_load_cell.device import DscLoadCell
from drivers.dsc_load_cell.message import Answer, DscLoadCellConfig, Number, decode_number, read_command

__all__ = ["Answer", "DscLoadCell", "DscLoadCellConfig", "Number", "decode_number", "read_command"]
