"""Every error the model raises on purpose."""


class ModelError(Exception):
    """Base of them all. The message is a sentence that ends with the remedy."""


class UrdfError(ModelError, ValueError):
    """The URDF cannot be used as this vehicle."""


class UnknownFrameError(ModelError, LookupError):
    """A link, joint or frame name that the URDF does not have."""


class SignalError(ModelError, ValueError):
    """Signals of a wrong shape, or not finite."""
