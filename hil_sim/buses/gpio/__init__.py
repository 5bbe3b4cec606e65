"""GPIO lines of a flight computer."""
