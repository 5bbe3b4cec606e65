"""A log through the flight's own estimator: fed in its steps, compared with what was estimated onboard."""
