"""The recursive estimators: square-root kernel, window, memory."""
