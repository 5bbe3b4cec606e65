"""What ``bench/acquisition.py`` measures: one pump of a driver each, and the naive loop beside it."""
