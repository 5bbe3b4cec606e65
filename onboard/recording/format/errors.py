"""Error tree of logs. Errors of the disk remain OSError."""


class RecordingError(Exception):
    """Base of all recording errors. The message ends with the remedy."""


class SchemaError(RecordingError, ValueError):
    """A dtype that ``ros2msg`` cannot express, or a schema text that gives no dtype."""


class ChannelError(RecordingError, ValueError):
    """A channel that is not in the log, or rows that are not of the channel's dtype."""


class LogFormatError(RecordingError, ValueError):
    """Bytes that violate the log format."""


class ChecksumError(LogFormatError):
    """A record with consistent lengths and a wrong CRC: the record after it can still be found."""
