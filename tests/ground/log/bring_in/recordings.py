"""Recordings of others to import: CSV text with its mapping, and an NPZ file for a packaged mapping."""

import numpy as np

CSV_MAPPING = """
[mapping]
name = "bench"
format = "csv"
[csv]
delimiter = ";"
header_line = 2
[time]
column = "t"
unit = "s"
offset = 0.5
[channel.imu]
record = "imu"
[channel.imu.accel]
columns = ["ax", "ay", "az"]
values = "physical"
scale = 0.01
unit = "g"
[channel.imu.gyro]
columns = ["gx", "gy", "gz"]
axes = ["+z", "-x", "+y"]
scale = [1, 4]
unit = "deg/s"
[channel.joint]
record = "scalar"
time = { column = "tj", unit = "us" }
[channel.joint.value]
column = "angle"
sign = "-"
scale = [1, 1000]
unit = "rev"
"""


CSV_TEXT = """\
exported by something
t;ax;ay;az;gx;gy;gz;tj;angle;note
0.1;0.011;-1;0.5;1;2;3;7;10;hello
0.2;1;2;3;-32768;32767;4;9;-20;world
"""


def npz(path, **changes):
    """A recording laid out as the packaged mapping expects."""
    count = 6
    arrays = {
        "time_us": np.arange(count, dtype=np.int64) * 248 + 1_000_000,
        "gyro_raw": np.arange(3 * count, dtype=np.int16).reshape(count, 3),
        "acc_raw": np.arange(3 * count, dtype=np.int16).reshape(count, 3) * 10,
        "erpm_raw": np.arange(count, dtype=np.int32) * 7,
    }
    np.savez(path, **{**arrays, **changes})
    return path
