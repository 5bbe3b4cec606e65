"""Proposes a mapping for a recording that nobody described (``heft import --guess``)."""
