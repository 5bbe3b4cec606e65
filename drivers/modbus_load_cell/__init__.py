"""Load cell transmitter on Modbus-RTU, Laumas register map (TLB, TLU, LCB; Bosche WTS uses the same).

Sources: Laumas TLU manual (registers and exceptions, pages 33-36), LCB manual (status register, page 3 of its fieldbus
part), Modbus over Serial Line 1.02. Known limits: weights are magnitudes with their sign in the status register; the
codes of register 40014 are not verified against a manual, and the effect of its coefficient on units other than mass is
unknown, so such units must be configured; the converter runs on its own clock, so a sample may be one conversion old.
"""

from drivers.modbus_load_cell.device import ModbusLoadCell
from drivers.modbus_load_cell.frame import ModbusException, ModbusReply, crc16, read_request
from drivers.modbus_load_cell.registers import ModbusLoadCellConfig, decode_weights

__all__ = [
    "ModbusException",
    "ModbusLoadCell",
    "ModbusLoadCellConfig",
    "ModbusReply",
    "crc16",
    "decode_weights",
    "read_request",
]
