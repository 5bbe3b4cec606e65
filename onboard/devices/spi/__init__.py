"""Devices on SPI."""
