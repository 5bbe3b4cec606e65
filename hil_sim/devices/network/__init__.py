"""Simulated devices with a connection of their own on a network."""
