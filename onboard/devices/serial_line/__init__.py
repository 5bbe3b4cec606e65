"""Kinds of device on a serial line."""
