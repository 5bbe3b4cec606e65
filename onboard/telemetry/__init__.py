"""Downlink of a flight: CCSDS space packets, made of the rings by a process of its own, and read back on the ground.

- ``packets``: kinds of packets, their fields; a packet's bytes and values. ``values``: fields from rows.
- ``xtce``: the same as a mission database (XTCE 1.2).
- ``stream``: bytes to packets, whatever happened to them on the way; gaps by sequence counts.
- ``downlink``: which packet is sent next, under a budget of bytes.
- ``link``, ``process``: where bytes go, and the process that sends them.
- ``uplink``, ``commanding``, ``span``: what may be asked of the flight, where its vehicle file arms it; ``commander``
  asks it from the ground.
"""
