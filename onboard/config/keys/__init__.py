"""Meanings of the keys of a vehicle file, for its schema and its page."""
