"""The simulated sync box and its pulse line."""
