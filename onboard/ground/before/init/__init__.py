"""A vehicle to begin with: ``heft init``."""
