"""Prescribed motions of bases and joints."""
