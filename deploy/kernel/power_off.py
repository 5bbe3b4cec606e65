"""Last program of the guest: reboot(2), for a minimal system has no poweroff."""

import ctypes
import os

_RB_POWER_OFF = 0x4321FEDC  # linux/reboot.h

os.sync()
ctypes.CDLL(None).reboot(_RB_POWER_OFF)
