"""Ticks of the estimator from samples: roles, signals, witnesses, torques, tracked poses."""
