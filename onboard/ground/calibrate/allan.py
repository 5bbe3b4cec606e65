"""Allan deviation of an IMU at rest: white noise and bias instability (IEEE 952; allantools computes it)."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray
from onboard.estimation.errors import CalibrationError
from onboard.ground.calibrate.readings import LogSpan, Readings

SHORTEST_s = 60.0
_WHITE_s = (0.1, 1.0)  # above the chip's low-pass filter, below its instability


class Allan(NamedTuple):
    """Of the six axes, gyro first."""

    tau_s: FloatArray  # (m,)
    deviation: FloatArray  # (m, 6) rad/s, m/s^2
    sample_noise: FloatArray  # (6,) of white samples at the sample rate, 1 sigma
    relative_sigma: float  # of sample_noise


def allan_deviation(read: Readings, span: LogSpan) -> Allan:
    """Overlapping Allan deviation over a rest.

    White noise of density N (one-sided) has ``sigma(tau) = N / sqrt(2 tau)``, and a white sample at rate f has
    ``N sqrt(f / 2) = sigma(tau) sqrt(tau f)``.

    Raises:
        CalibrationError: too short, or allantools is not installed.
    """
    if span.end_s - span.start_s < SHORTEST_s:
        raise CalibrationError(
            f"the longest rest is {span.end_s - span.start_s:.0f} s; leave it alone for {SHORTEST_s:.0f} s and more, "
            "half an hour for the bias instability"
        )
    try:
        import allantools  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise CalibrationError(f"the Allan deviation needs allantools ({error}): pip install allantools") from error
    values = read.values[read.within(span)]
    rate = (len(values) - 1) / (span.end_s - span.start_s)
    wanted = np.geomspace(10.0 / rate, (span.end_s - span.start_s) / 5.0, 40)
    columns = [allantools.oadev(column, rate, "freq", wanted) for column in values.T]
    tau = np.asarray(columns[0][0], np.float64)
    deviation = np.column_stack([one[1] for one in columns])
    white = (tau >= _WHITE_s[0]) & (tau <= _WHITE_s[1])
    noise = np.sqrt(np.mean(deviation[white] ** 2 * tau[white, None] * rate, axis=0))
    independent = (span.end_s - span.start_s) / _WHITE_s[1] * 2.0
    return Allan(tau, deviation, noise, float(1.0 / np.sqrt(2.0 * independent)))


def plot(allan: Allan, path: Path) -> None:
    """Both triads' deviations as a figure, its format by the suffix.

    Raises:
        ValueError: a format that Matplotlib does not write.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 - half a second to import
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=(9, 4), layout="constrained")
    FigureCanvasAgg(figure)
    for place, (name, unit) in enumerate((("gyro", "rad/s"), ("accelerometer", "m/s^2"))):
        axes = figure.add_subplot(1, 2, place + 1)
        for axis in range(3):
            axes.loglog(allan.tau_s, allan.deviation[:, 3 * place + axis], label="xyz"[axis])
        axes.set_xlabel("averaging time, s")
        axes.set_ylabel(f"Allan deviation of the {name}, {unit}")
        axes.grid(True, which="both", alpha=0.3)
        axes.legend()
    figure.savefig(path)
