"""``heft mechanics``: reaction of a floating base to its arm."""
