"""A log on the ground: tables of its channels, views, export, rescue, foreign recordings brought in."""
