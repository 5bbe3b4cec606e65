"""``heft mechanics``: what a vehicle's arm does to its base, before anything flies."""
