"""Proposes a mapping for a recording without a description (``heft import --guess``)."""
