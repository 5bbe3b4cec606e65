"""What ``import heft`` gives: a log as channels, tables and estimates. Nothing is read before it is asked for."""
