"""The flight app: workers as step functions, and the runners that call them."""
