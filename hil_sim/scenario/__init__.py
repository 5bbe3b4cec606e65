"""Scenarios as validated TOML tables; ``packaged/`` holds those shipped with heft."""
