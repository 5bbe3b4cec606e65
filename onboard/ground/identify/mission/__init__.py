"""A rehearsal's answers beside the truth of its world."""
