"""Flights of the honesty campaign (``bench/honesty.py``): what is drawn by a seed, how it is flown, what came of it."""
