"""The estimator that flew, run on logs (``heft replay``, ``heft identify``)."""
