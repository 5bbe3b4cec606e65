"""On the ground: logs as tables and pages, the estimator on recorded flights, what precedes and follows a flight."""
