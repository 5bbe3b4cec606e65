"""Live view of a running flight in Foxglove or Lichtblick: a separate process serves the rings over a WebSocket.

The process only reads the rings: no worker of the flight waits for it, and a slow viewer loses messages or its
connection.
"""
