"""Records in, answers out: the estimator of a flight, its signals, its checkpoints."""
