"""Bytes to records: sans-I/O decoders, and devices that pump a port through them.

Nothing here imports the rest of heft, and nothing but ``drivers.transports`` imports a bus library.
"""
