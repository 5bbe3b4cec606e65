"""True flights of the free-flyer, on a table too, and samples of them, for tests and benches of estimators."""
