"""Stated sigmas that the rows consider, draw from or fit."""
