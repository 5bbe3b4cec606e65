"""Reading a log: its channels as columns and SI values, by time and phase, and the vehicle file it carries."""
