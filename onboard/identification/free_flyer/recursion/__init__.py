"""The recursive fit of a free-flyer: window, bounded work, trials."""
