"""A log through the flight's estimator: fed in its steps, compared with what was estimated onboard."""
