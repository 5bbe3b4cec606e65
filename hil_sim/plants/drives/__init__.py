"""Servo drives of a vehicle's joints."""
