"""Logs in memory, read by the stock ``mcap`` package and ``mcap-ros2-support``."""

import io

from mcap.reader import SeekingReader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory

from onboard.recording.writer import LogWriter
from tests.recording.logs import MemorySink


def written(build, **arguments):
    """The bytes of a log that ``build(writer)`` fills."""
    sink = MemorySink()
    with LogWriter(sink, **arguments) as writer:
        build(writer)
    return bytes(sink.data)


def chunks(data):
    return [
        r for r in StreamReader(io.BytesIO(data), emit_chunks=True, validate_crcs=True).records if isinstance(r, Chunk)
    ]


def stock_rows(data):
    """Decoded messages by topic, by the stock reader with all checks on."""
    found = {}
    reader = SeekingReader(io.BytesIO(data), validate_crcs=True, decoder_factories=[DecoderFactory()])
    for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
        found.setdefault(channel.topic, []).append((message, decoded))
    return found


def field_bytes(row, name):
    """The field's own bytes, NULs at its end too."""
    field, offset = row.dtype.fields[name][:2]
    return row.tobytes()[offset : offset + field.itemsize]


def assert_same(rows, decoded):
    assert len(rows) == len(decoded)
    for row, (message, ours) in zip(rows, decoded, strict=True):
        assert message.log_time == message.publish_time == int(row["host_ns"])
        assert message.sequence == int(row["sequence"]) % 2**32
        for name in row.dtype.names:
            field, seen = row.dtype[name], getattr(ours, name)
            if field.base.kind == "S":
                assert bytes(seen) == field_bytes(row, name), name
            elif field.shape:
                assert list(seen) == row[name].reshape(-1).tolist(), name
            else:
                assert seen == row[name].item(), name
