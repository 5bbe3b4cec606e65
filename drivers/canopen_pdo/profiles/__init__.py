"""Channels of a CANopen bus by device profile: objects read, mapped and configured."""
