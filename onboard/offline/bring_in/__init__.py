"""Recordings from elsewhere to logs, by a mapping file (``heft import``)."""
