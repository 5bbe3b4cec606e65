"""Identification by least squares on measurement rows, with or without instrumental variables."""
