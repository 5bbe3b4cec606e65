"""What a log or a flight looks like in a terminal: ``heft info``, ``heft watch``, the result of ``heft hil``."""
