"""Identification by least squares on measurement rows."""
