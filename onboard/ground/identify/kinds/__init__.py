"""Estimation from a log by kind of base: what each fits, and the form of every result."""
