"""Every error a driver raises on purpose. Anything else out of ``drivers`` is our bug."""


class DriverError(Exception):
    """Base of them all. The message is a sentence that ends with the remedy."""


class FrameError(DriverError, ValueError):
    """Bytes that cannot be a frame of this device."""


class WrongDeviceError(DriverError, LookupError):
    """Something answers, and it is not the device the configuration names."""


class NoAnswerError(DriverError, ConnectionError):
    """Nothing answers at this address or node number."""


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
    """A device's own test of itself does not come out as its factory says.

    Attributes:
        deviations: Relative deviation of each axis, gyro x, y, z, accel x, y, z; empty where they cannot be told.
    """

    def __init__(self, message: str, deviations: tuple[float, ...]) -> None:
        super().__init__(message)
        self.deviations = deviations
