"""Health of a real flight and of its computer."""
