"""InvenSense MPU-6050 inertial measurement unit (and its clones) on I2C, read from its FIFO or its data registers.

Sources: register map RM-MPU-6000A 4.2, product specification PS-MPU-6000A 3.4. Known limits: the sync flag replaces one
temperature LSB; the chip runs up to 1 % off its nominal rate, so rows carry a sample number and no sample time.
"""

from drivers.mpu6050.device import Mpu6050
from drivers.mpu6050.fifo import decode_packets
from drivers.mpu6050.registers import Mpu6050Config

__all__ = ["Mpu6050", "Mpu6050Config", "decode_packets"]
