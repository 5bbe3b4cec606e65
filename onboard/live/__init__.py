"""A running flight for Foxglove and Lichtblick, over a WebSocket, by a process of its own that only reads the rings.

The flight knows nothing of it: no worker waits for it, and a viewer that is too slow loses messages or its connection.
"""
