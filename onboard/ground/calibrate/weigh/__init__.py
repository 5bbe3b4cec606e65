"""Weighs a tool by a wrist force-torque sensor: a table of static poses is read, fitted, judged and shown."""
