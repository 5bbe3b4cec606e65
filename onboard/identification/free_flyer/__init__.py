"""Non-linear ExIDDM: fits the payload so that the predicted base IMU signals match the measured ones."""
