"""Devices of registers on I2C: bus access with retries, the base of their drivers, and the drivers themselves."""
