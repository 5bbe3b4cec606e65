"""Self test of the MPU-6050: response to electrostatic actuation compared with the factory trim.

Source: RM-MPU-6000A 4.2, registers 13 to 16 and 27, 28. The response is the change of the outputs when the actuators
are switched on (gyro at +-250 deg/s, accel at +-8 g); its relative deviation from the factory trim FT must stay within
14 %. Known limits: the accel trim formula and the sign of the Y gyro are not verified on a chip.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.errors import FrameError, SelfTestError
from drivers.i2c.bus import RegisterBus
from drivers.inertial.packet import PACKET_BYTES
from drivers.mpu6050 import registers as reg

LIMIT = 0.14  # PS 6.1, 6.2
AXES = ("gyro x", "gyro y", "gyro z", "accel x", "accel y", "accel z")
ALL_ON_GYRO_250 = 0xE0  # XG_ST, YG_ST, ZG_ST; FS_SEL = 0
ALL_ON_ACCEL_8G = 0xF0  # XA_ST, YA_ST, ZA_ST; AFS_SEL = 2
ALL_OFF_GYRO_250, ALL_OFF_ACCEL_8G = 0x00, 0x10
FILTER_94_HZ = 2
WAKE_S = 0.1
SETTLE_S = 0.25
READS, READ_EVERY_S = 100, 0.002

QUIET = {  # register values during the test
    reg.PWR_MGMT_1: reg.CLOCK_PLL_GYRO_X,
    reg.PWR_MGMT_2: 0,
    reg.USER_CTRL: 0,
    reg.FIFO_EN: 0,
    reg.INT_ENABLE: 0,
    reg.SMPLRT_DIV: 0,
    reg.CONFIG: FILTER_94_HZ,
    reg.GYRO_CONFIG: ALL_OFF_GYRO_250,
    reg.ACCEL_CONFIG: ALL_OFF_ACCEL_8G,
}


class SelfTest(NamedTuple):
    """Relative deviation of each axis from its factory trim: 0.05 is 5 % above it."""

    gyro_deviation: tuple[float, float, float]
    accel_deviation: tuple[float, float, float]

    @property
    def worst(self) -> float:
        """Largest of them."""
        return max(map(abs, (*self.gyro_deviation, *self.accel_deviation)))


def factory_trim(codes: bytes) -> NDArray[np.float64]:
    """Factory self-test response (RM registers 13 to 16).

    Args:
        codes: Registers 0Dh..10h: SELF_TEST_X, Y, Z, A.

    Returns:
        Counts at +-250 deg/s and +-8 g, gyro x, y, z, accel x, y, z; 0 where the chip has no code. Shape (6,).

    Raises:
        FrameError: Not four bytes.
    """
    if len(codes) != 4:
        raise FrameError(f"{len(codes)} bytes are no factory trim: read four from register 0x0d")
    low = codes[3]
    gyro = [code & 0x1F for code in codes[:3]]
    accel = [(code >> 5) << 2 | low >> shift & 3 for code, shift in zip(codes[:3], (4, 2, 0), strict=True)]
    trim = np.zeros(6)
    for place, (code, sign) in enumerate(zip(gyro, (1.0, -1.0, 1.0), strict=True)):
        if code:
            trim[place] = sign * 25.0 * 131.0 * 1.046 ** (code - 1)  # register 13: FT [Xg]
    for place, code in enumerate(accel):
        if code:
            trim[3 + place] = 4096.0 * 0.34 * (0.92 / 0.34) ** ((code - 1) / 30.0)  # register 16: FT [Xa]
    return trim


def deviation(response: NDArray[np.float64], trim: NDArray[np.float64]) -> SelfTest:
    """How far the response of each axis is from its trim, gyro x, y, z, accel x, y, z, counts, shapes (6,).

    Raises:
        SelfTestError: An axis is beyond ``LIMIT``, or has no trim to compare with.
    """
    blank = [axis for axis, value in zip(AXES, trim, strict=True) if value == 0.0]
    if blank:
        raise SelfTestError(f"no factory trim for {', '.join(blank)}: a clone, or a blank chip; fit another", ())
    relative = (response / trim - 1.0).tolist()
    failed = [f"{axis} {100 * value:+.0f} %" for axis, value in zip(AXES, relative, strict=True) if abs(value) > LIMIT]
    if failed:
        raise SelfTestError(
            f"{', '.join(failed)} off the factory trim, 14 % allowed: keep it still and repeat, then replace the chip",
            tuple(relative),
        )
    gx, gy, gz, ax, ay, az = relative
    return SelfTest((gx, gy, gz), (ax, ay, az))


def run_self_test(name: str, bus: RegisterBus, wait: Callable[[float], object]) -> SelfTest:
    """Test the chip and leave its settings as they were, also when the test fails.

    Args:
        name: Device name, for messages.
        bus: Its registers.
        wait: Sleeps for that many seconds.

    Raises:
        SelfTestError: See ``deviation``.
        OSError: The bus failed; settings are restored as far as possible.
    """
    before = {register: bus.byte(register) for register in QUIET}
    try:
        for register, value in QUIET.items():
            bus.write(register, value)
        wait(WAKE_S + SETTLE_S)
        passive = _mean(bus, wait)
        bus.write(reg.GYRO_CONFIG, ALL_ON_GYRO_250)
        bus.write(reg.ACCEL_CONFIG, ALL_ON_ACCEL_8G)
        wait(SETTLE_S)
        active = _mean(bus, wait)
        codes = bus.read(reg.SELF_TEST_X, 4).data
    except BaseException:
        _put_back(bus, before)
        raise
    failed = _put_back(bus, before)
    if failed is not None:
        raise failed
    wait(SETTLE_S)
    try:
        return deviation(active - passive, factory_trim(codes))
    except SelfTestError as error:
        raise SelfTestError(f"{name}: {error}", error.deviations) from None


def _put_back(bus: RegisterBus, before: dict[int, int]) -> OSError | None:
    """Restore every changed register, power management last; returns the last error."""
    failed: OSError | None = None
    for register in reversed(before):
        try:
            bus.write(register, before[register])
        except OSError as error:
            failed = error
    return failed


def _mean(bus: RegisterBus, wait: Callable[[float], object]) -> NDArray[np.float64]:
    """Mean of the data registers, counts, gyro x, y, z, accel x, y, z, shape (6,)."""
    total = np.zeros(7)
    for _ in range(READS):
        total += np.frombuffer(bus.read(reg.ACCEL_XOUT_H, PACKET_BYTES).data, ">i2")
        wait(READ_EVERY_S)
    return total[[4, 5, 6, 0, 1, 2]] / READS
