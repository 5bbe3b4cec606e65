"""Builds the summary section of a log, while it is written or from a log whose writer died."""

from mcap.opcode import Opcode
from mcap.records import Statistics

from onboard.recording.format import mcap_format
from onboard.recording.format.mcap_format import Attachment, Chunk, Metadata


class SummarySection:
    """Collects the summary section. Definitions are kept as packed records, in order."""

    def __init__(self) -> None:
        self.counts: dict[int, int] = {}  # messages by channel number
        self._schemas: dict[bytes, None] = {}
        self._channels: dict[bytes, None] = {}
        self._chunks: list[bytes] = []
        self._attachments: list[bytes] = []
        self._metadata: list[bytes] = []
        self._span: tuple[int, int] | None = None

    def define(self, definitions: dict[tuple[str, int], bytes]) -> None:
        """Packed schema and channel records, by kind (``schema``, ``channel``) and number."""
        for (kind, number), packed in definitions.items():
            if kind == "schema":
                self._schemas[packed] = None
            else:
                self._channels[packed] = None
                self.counts.setdefault(number, 0)

    def add_chunk(self, chunk: Chunk, offset: int, length: int, positions: dict[int, int], indexes_length: int) -> None:
        """A chunk record of ``length`` bytes at ``offset``; ``positions``: where each channel's index record stands."""
        self._chunks.append(mcap_format.pack_chunk_index(chunk, offset, length, positions, indexes_length))
        if positions:
            start_ns, end_ns = self._span or (chunk.start_ns, chunk.end_ns)
            self._span = min(start_ns, chunk.start_ns), max(end_ns, chunk.end_ns)

    def add_attachment(self, attachment: Attachment, offset: int, length: int) -> None:
        """An attachment record of ``length`` bytes at ``offset``."""
        self._attachments.append(attachment.pack_index(offset, length))

    def add_metadata(self, metadata: Metadata, offset: int, length: int) -> None:
        """A metadata record of ``length`` bytes at ``offset``."""
        self._metadata.append(metadata.pack_index(offset, length))

    def pack_end(self, offset: int, data_crc: int) -> bytes:
        """From the data end record, which will stand at ``offset``, to the last magic."""
        start_ns, end_ns = self._span or (0, 0)
        statistics = Statistics(
            schema_count=len(self._schemas),
            channel_count=len(self._channels),
            attachment_count=len(self._attachments),
            metadata_count=len(self._metadata),
            chunk_count=len(self._chunks),
            message_count=sum(self.counts.values()),
            channel_message_counts=self.counts,
            message_start_time=start_ns,
            message_end_time=end_ns,
        )
        groups: dict[int, bytes] = {
            Opcode.SCHEMA: b"".join(self._schemas),
            Opcode.CHANNEL: b"".join(self._channels),
            Opcode.STATISTICS: mcap_format.pack(statistics),
            Opcode.CHUNK_INDEX: b"".join(self._chunks),
            Opcode.ATTACHMENT_INDEX: b"".join(self._attachments),
            Opcode.METADATA_INDEX: b"".join(self._metadata),
        }
        return mcap_format.pack_end(offset, data_crc, groups)
