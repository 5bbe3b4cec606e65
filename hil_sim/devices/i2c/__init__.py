"""Emulators of devices on I2C that stand on ``twin``."""
