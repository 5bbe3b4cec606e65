"""Terminal views of a log or a flight: ``heft info``, ``heft watch``, the result of ``heft hil``."""
