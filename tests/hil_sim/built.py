"""Overrides of a scenario for tests that compare with numbers of the drawing."""

_EXACT = {"density_relative": 0.0, "mass_relative": 0.0, "centre_mm": 0.0, "inertia_relative": 0.0, "place_mm": 0.0}
AS_DRAWN = {"arm": _EXACT, "tip_mass": _EXACT}
