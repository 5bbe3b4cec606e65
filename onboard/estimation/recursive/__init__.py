"""The recursive estimators: square-root kernel, blocks of time."""
