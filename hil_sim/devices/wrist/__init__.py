"""Simulated wrist sensors: six components, of which a table each stands for one."""
