"""Error tree of ``drivers``. Any other exception raised from this package is a bug in it."""


class DriverError(Exception):
    """Base of all driver errors. The message ends with the remedy."""


class FrameError(DriverError, ValueError):
    """Bytes that cannot be a frame of this device."""


class WrongDeviceError(DriverError, LookupError):
    """The device that answers is not the one the configuration names."""


class NoAnswerError(DriverError, ConnectionError):
    """No device answers at this address or node number."""


class ConfigurationError(DriverError, ValueError):
    """The device cannot be set up as asked (a range, rate or object it does not have)."""


class UrlError(DriverError, ValueError):
    """A bus URL that names no transport, or lacks a part that its transport needs."""


class SdoAbortError(DriverError, RuntimeError):
    """A CANopen node refused an SDO transfer.

    Attributes:
        code: The abort code (CiA 301, section 7.2.4.3.17).
    """

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class SelfTestError(DriverError, RuntimeError):
    """A device's built-in self test deviates from its factory trim.

    Attributes:
        deviations: Relative deviation per axis, gyro x, y, z, accel x, y, z; empty if the chip has no factory trim.
    """

    def __init__(self, message: str, deviations: tuple[float, ...]) -> None:
        super().__init__(message)
        self.deviations = deviations
