"""Before a flight: a new vehicle's files, what a motion determines, planned motions, mechanics, control on trial."""
