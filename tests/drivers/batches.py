"""What the drivers' tests ask of a list of batches."""

import numpy as np

from drivers.records import Batch


def of(batches: list[Batch], channel: str) -> np.ndarray:
    """All rows of a channel, in order."""
    rows = [batch.rows for batch in batches if batch.channel == channel]
    if not rows:
        return np.zeros(0, [("sequence", "<u8")])
    assert len({part.dtype for part in rows}) == 1
    data = bytearray(b"".join(part.tobytes() for part in rows))  # np.concatenate compares types field by field
    return np.frombuffer(data, rows[0].dtype)


def codes(batches: list[Batch]) -> list[str]:
    """Codes of the events, in order."""
    return [row["code"].decode() for batch in batches if batch.channel == "event" for row in batch.rows]


def texts(batches: list[Batch], code: str) -> list[str]:
    """Texts of the events of one code."""
    rows = of(batches, "event")
    return [row["text"].decode() for row in rows if row["code"].decode() == code]


def whole(batches: list[Batch], channel: str) -> np.ndarray:
    """Rows of a channel, after a check that sequence numbers and gaps together leave nothing out from 0 on."""
    rows = of(batches, channel)
    covered = list(rows["sequence"])
    for gap in of(batches, "gap"):
        if gap["channel"] == channel.encode():
            covered += range(gap["first_missing"], gap["last_missing"] + 1)
    assert sorted(covered) == list(range(len(covered))), "rows and gaps do not add up"
    return rows
