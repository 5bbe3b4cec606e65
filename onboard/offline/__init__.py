"""What an analyst does with a log on the ground: look into it, turn it into tables, run the estimator on it again."""
