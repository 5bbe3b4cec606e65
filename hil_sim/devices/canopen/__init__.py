"""Simulated CANopen devices and the CAN wire."""
