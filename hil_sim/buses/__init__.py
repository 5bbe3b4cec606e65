"""The media between twins and flight computer, and the ends of them in process (T0) or on ptys and sockets (T1)."""
