"""Converts foreign recordings to logs by a mapping file (``heft import``)."""
