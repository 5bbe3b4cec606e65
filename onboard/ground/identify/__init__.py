"""Recorded flights through the onboard estimator or a batch fit (``heft replay``, ``heft identify``)."""
