"""``heft calibrate``: what a log of a bench run says of an instrument or a body, and how it goes into vehicle.toml."""
