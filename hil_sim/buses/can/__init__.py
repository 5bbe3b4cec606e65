"""Ends of a CAN bus: in the flight computer's process, and serial CAN adapters."""
