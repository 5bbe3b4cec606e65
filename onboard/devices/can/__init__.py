"""Kinds of device on a CAN bus."""
