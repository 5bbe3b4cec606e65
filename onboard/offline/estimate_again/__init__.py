"""Runs the onboard estimator on logs (``heft replay``, ``heft identify``)."""
