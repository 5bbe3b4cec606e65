"""Reads a log as tables: columns, SI values, selection by time and phase, the attached vehicle file."""
