"""A state in memory."""

import io

from onboard.flight.estimate.state import UnwrittenParts, write


def to_bytes(thing: object, places: UnwrittenParts) -> bytes:
    """What ``write`` writes."""
    file = io.BytesIO()
    write(file, thing, places)
    return file.getvalue()
