"""CANopen frames, object dictionary and process data on the wire."""
