"""Registers of the InvenSense MPU-6050 (RM-MPU-6000A rev. 4.2), as the simulated chip implements them."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

SELF_TEST_X: Final = 0x0D  # [7:5] XA_TEST[4:2], [4:0] XG_TEST
SELF_TEST_Y: Final = 0x0E
SELF_TEST_Z: Final = 0x0F
SELF_TEST_A: Final = 0x10  # [5:4] XA_TEST[1:0], [3:2] YA_TEST[1:0], [1:0] ZA_TEST[1:0]
SMPLRT_DIV: Final = 0x19
CONFIG: Final = 0x1A  # [5:3] EXT_SYNC_SET, [2:0] DLPF_CFG
GYRO_CONFIG: Final = 0x1B  # [7:5] self-test x, y, z, [4:3] FS_SEL
ACCEL_CONFIG: Final = 0x1C  # [7:5] self-test x, y, z, [4:3] AFS_SEL
FIFO_EN: Final = 0x23  # 7 temperature, 6 gyro x, 5 y, 4 z, 3 accelerometer
I2C_MST_STATUS: Final = 0x36  # 7 PASS_THROUGH: FSYNC interrupt
INT_PIN_CFG: Final = 0x37  # 4 INT_RD_CLEAR, 2 FSYNC_INT_EN
INT_STATUS: Final = 0x3A  # 4 FIFO overflow, 0 data ready
ACCEL_XOUT_H: Final = 0x3B  # 14 bytes: accelerometer, temperature, gyro, big-endian
GYRO_ZOUT_L: Final = 0x48
USER_CTRL: Final = 0x6A  # 6 FIFO_EN, 2 FIFO_RESET, 1 I2C_MST_RESET, 0 SIG_COND_RESET
PWR_MGMT_1: Final = 0x6B  # 7 DEVICE_RESET, 6 SLEEP, 5 CYCLE, 3 TEMP_DIS, [2:0] CLKSEL
PWR_MGMT_2: Final = 0x6C  # [7:6] LP_WAKE_CTRL, [5:3] standby accel x, y, z, [2:0] standby gyro x, y, z
SIGNAL_PATH_RESET: Final = 0x68
FIFO_COUNT_H: Final = 0x72
FIFO_COUNT_L: Final = 0x73
FIFO_R_W: Final = 0x74
WHO_AM_I: Final = 0x75

RESET_VALUES: Final = {PWR_MGMT_1: 0x40, WHO_AM_I: 0x68}  # every other register: 0x00 (RM section 3)

# What the interface may write. The FIFO, status, count and identity registers are handled one by one.
WRITABLE: Final = frozenset(
    {
        *range(0x06, 0x0C),  # accelerometer offsets (undocumented; stored, without effect on the output)
        *range(0x13, 0x19),  # gyro offsets (likewise)
        *range(0x19, 0x1D),
        0x1F,  # MOT_THR
        0x23,
        *range(0x24, 0x35),  # auxiliary I2C master (stored: nothing hangs on its bus)
        0x37,
        0x38,  # INT_ENABLE
        *range(0x63, 0x68),
        0x69,  # MOT_DETECT_CTRL
        0x6C,
    }
)

FIFO_SIZE: Final = 1024
INT_DATA_RDY: Final = 0x01
INT_FIFO_OFLOW: Final = 0x10

ACCEL_LSB_PER_G: Final = (16384.0, 8192.0, 4096.0, 2048.0)  # by AFS_SEL: 2, 4, 8, 16 g
GYRO_LSB_PER_DPS: Final = (131.0, 65.5, 32.8, 16.4)  # by FS_SEL: 250, 500, 1000, 2000 deg/s

# Column of the (accel x y z, temperature, gyro x y z) sample whose least significant bit EXT_SYNC_SET replaces.
SYNC_COLUMN: Final = (None, 3, 4, 5, 6, 0, 1, 2)

LP_WAKE_PERIOD_NS: Final = (800_000_000, 200_000_000, 50_000_000, 25_000_000)  # 1.25, 5, 20, 40 Hz


class FactoryTrim(NamedTuple):
    """Five-bit factory self-test codes (G_TEST, A_TEST), axes x, y, z; 0 means that none was stored."""

    gyro: tuple[int, int, int] = (16, 17, 15)
    accel: tuple[int, int, int] = (18, 17, 19)

    def registers(self) -> bytes:
        """The four bytes at 0x0D..0x10."""
        rows = [(a >> 2) << 5 | g for a, g in zip(self.accel, self.gyro, strict=True)]
        low = (self.accel[0] & 3) << 4 | (self.accel[1] & 3) << 2 | (self.accel[2] & 3)
        return bytes([*rows, low])

    def gyro_response_lsb(self) -> tuple[float, float, float]:
        """Output change with self-test on, at +-250 deg/s: 25 * 131 * 1.046^(G_TEST - 1), y negative (RM 4.1)."""
        x, y, z = (25.0 * 131.0 * 1.046 ** (code - 1) if code else 0.0 for code in self.gyro)
        return x, -y, z

    def accel_response_lsb(self) -> tuple[float, float, float]:
        """Output change with self-test on, at +-8 g: 4096 * 0.34 * (0.92 / 0.34)^((A_TEST - 1) / 30) (RM 4.1)."""
        x, y, z = (4096.0 * 0.34 * (0.92 / 0.34) ** ((code - 1) / 30.0) if code else 0.0 for code in self.accel)
        return x, y, z

    def response_lsb(self, accel_on: int, gyro_on: int, accel_lsb: float, gyro_lsb: float) -> NDArray[np.float64]:
        """What self-test adds to a sample at the ranges set, (7,) in the order of the data registers.

        Args:
            accel_on: ACCEL_CONFIG; bits 7 to 5 switch it on for x, y, z.
            gyro_on: GYRO_CONFIG, likewise.
            accel_lsb: LSB per g.
            gyro_lsb: LSB per deg/s.
        """
        response = np.zeros(7)
        for axis in range(3):
            if accel_on & 0x80 >> axis:
                response[axis] = self.accel_response_lsb()[axis] * accel_lsb / ACCEL_LSB_PER_G[2]
            if gyro_on & 0x80 >> axis:
                response[4 + axis] = self.gyro_response_lsb()[axis] * gyro_lsb / GYRO_LSB_PER_DPS[0]
        return response


def held_columns(power: int, standby: int) -> list[int]:
    """Columns of sensors that are off by PWR_MGMT_1 and 2: standby bits, TEMP_DIS, and the gyro in CYCLE mode."""
    if not (power & 0x28 or standby & 0x3F):
        return []
    held = [axis for axis in range(3) if standby & 0x20 >> axis]
    if power & 0x08:
        held.append(3)
    return held + [4 + axis for axis in range(3) if power & 0x20 or standby & 0x04 >> axis]
