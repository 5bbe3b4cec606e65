"""Error tree of the vehicle model."""


class ModelError(Exception):
    """Base of all model errors. The message ends with the remedy."""


class UrdfError(ModelError, ValueError):
    """The URDF cannot be used as this vehicle."""


class UnknownFrameError(ModelError, LookupError):
    """A link, joint or frame name that the URDF does not have."""


class SignalError(ModelError, ValueError):
    """Signals of a wrong shape, or not finite."""
