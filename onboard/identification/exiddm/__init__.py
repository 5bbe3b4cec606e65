"""Non-linear ExIDDM: the payload that makes the predicted base IMU agree with the measured one."""
