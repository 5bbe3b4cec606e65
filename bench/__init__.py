"""Measurements and long runs, each a script of its own. Nothing that flies imports this."""
