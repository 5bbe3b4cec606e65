"""A body without joints on an air-bearing table, by its thrusters and a tracked pose."""
