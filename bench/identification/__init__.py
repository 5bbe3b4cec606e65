"""Identification against its bars."""
