"""Prediction of what the instruments of a free-flyer read, from all unknowns: their errors, the links, the payload."""
