"""The Python interface (``import heft``): a log as channels, tables and estimates, read on demand."""
