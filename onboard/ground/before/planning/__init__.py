"""The joint motion that tells most about a payload, inside limits, by the bound of the flight's estimator."""
