"""The simulated InvenSense MPU-6050."""
