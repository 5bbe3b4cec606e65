"""What a vehicle can determine with a planned motion, before it flies: Cramer-Rao bounds by the flight's models."""
