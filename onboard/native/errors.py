"""Errors of the compiled core."""


class NativeError(OSError):
    """There is no library, and none can be made; the message has the remedy."""


class ArrayError(ValueError):
    """An array of another shape or type than a function of the library takes."""
