"""Devices on I2C whose drivers stand on ``drivers.i2c.sensor``."""
