"""Every error this room raises on purpose. What the disk refuses stays the OSError it was."""


class RecordingError(Exception):
    """Base of them all. The message is a sentence that ends with the remedy."""


class SchemaError(RecordingError, ValueError):
    """A dtype that ``ros2msg`` cannot say, or a schema text that no dtype can be rebuilt from."""


class ChannelError(RecordingError, ValueError):
    """A channel that is not in the log, or rows that are not of the channel's dtype."""


class LogFormatError(RecordingError, ValueError):
    """Bytes that are not what a log of ours holds at that place."""


class ChecksumError(LogFormatError):
    """A record that is whole, by its lengths, and altered, by its CRC: what follows it stands where it should."""
