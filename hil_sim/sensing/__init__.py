"""Truth to signals: what each sensor makes of the world, errors drawn once per seed, and chip clocks."""
