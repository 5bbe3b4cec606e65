"""Fit of a whole flight on the ground, free and held segments together, its parts, its tests and pools of such fits."""
