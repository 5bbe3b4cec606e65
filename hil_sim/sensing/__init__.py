"""Sensor models: true signals to measured signals with errors drawn once per seed, and chip clocks."""
