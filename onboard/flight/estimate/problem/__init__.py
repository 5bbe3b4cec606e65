"""The estimation problem that a vehicle's file states."""
