"""Known delays of sensors' own filters, removed when samples are put on vehicle time."""

# DLPF_CFG 0..6: delay of the accelerometer's and of the gyroscope's low-pass filter, s (register map, register 26)
MPU6050_FILTER_DELAY_S = (
    (0.0, 0.98e-3),
    (2.0e-3, 1.9e-3),
    (3.0e-3, 2.8e-3),
    (4.9e-3, 4.8e-3),
    (8.5e-3, 8.3e-3),
    (13.8e-3, 13.4e-3),
    (19.0e-3, 18.6e-3),
)
