"""Before a flight: preflight, checkout, room on the disk."""
