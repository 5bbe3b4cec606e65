"""Moment of inertia from the swings of a bifilar torsional pendulum (Jardin and Mueller 2009; Limparis section 4.2).

The body hangs by two strings of length h, D apart, its centre of mass midway below them, and swings about the vertical;
it rises by ``z = h - sqrt(h^2 - D^2 (1 - cos th) / 2)`` (4.1, 4.2), and drag is ``-K_D th' |th'| - C th'`` (4.3). With
the kinetic energy of the rise, which (4.4) leaves out (0.2 % at 35 deg),

    (I + m z_th^2) th'' + m z_th z_thth th'^2 + m g z_th + K_D th' |th'| + C th' = 0,    z_th = dz / d th

For small angles ``I = m g D^2 / (4 h w_n^2)`` (4.5). A gyro on the body measures th'. The fit is to that rate, with the
angle and rate at the start, both dampings and the gyro's bias unknown beside I; over ever more swings, since the
frequency of the first few does not find the way over many.
"""

import math
import warnings
from typing import NamedTuple

import numpy as np
from scipy.integrate import ODEintWarning, odeint
from scipy.optimize import least_squares
from scipy.signal import periodogram

from onboard.estimation.arrays import PAUSE, FloatArray
from onboard.estimation.errors import CalibrationError

LARGEST_ANGLE_rad = np.deg2rad(75.0)
FEWEST_SWINGS = 5.0
HOPELESS = 0.2  # the same while the fit is still on its way
INTEGRATION = 1e-11  # relative: its steps jump with the parameters, by 1e-8 enough to stop the fit 0.05 sigma off
SENSITIVITY = 1e-7  # the same of the derivatives by the parameters, which only point the way and weigh the noise
WORST_RESIDUAL = 0.02  # of the rate's rms; beyond, something else than a pendulum moved


class Suspension(NamedTuple):
    """How a body hangs, each length and the mass with its standard deviation."""

    mass_kg: float
    spacing_m: float  # D, between the strings
    length_m: float  # h, of each
    mass_sigma_kg: float = 0.0
    spacing_sigma_m: float = 0.0
    length_sigma_m: float = 0.0
    gravity_m_s2: float = 9.80665

    def stiffness(self) -> float:
        """``m g D^2 / (4 h)``, N m: what (4.5) divides by the squared frequency."""
        return self.mass_kg * self.gravity_m_s2 * self.spacing_m**2 / (4.0 * self.length_m)

    def relative_sigmas(self) -> dict[str, float]:
        """Of the inertia by what is measured with a rule and a scale."""
        return {
            "mass": self.mass_sigma_kg / self.mass_kg,
            "string spacing": 2.0 * self.spacing_sigma_m / self.spacing_m,
            "string length": self.length_sigma_m / self.length_m,
        }


class BifilarSwing(NamedTuple):
    """What one run says about the vertical axis through the centre of mass."""

    inertia_kg_m2: float
    sigma_kg_m2: float
    parts: dict[str, float]  # relative sigma by cause
    linear_kg_m2: float  # by (4.5), which takes the angle for small
    amplitude_rad: float  # at the start
    period_s: float  # of small swings
    viscous: float  # C, N m s
    by_scale_kg_m2: float  # what a gyro that shows so many times more than it turns does to the inertia


def swing(
    time_s: FloatArray, rate_rad_s: FloatArray, suspension: Suspension, gyro_scale_sigma: float = 0.0
) -> BifilarSwing:
    """The inertia of one free swing.

    Args:
        time_s: of the samples, increasing, (n,); the body was let go before the first.
        rate_rad_s: about the vertical, (n,).
        suspension: how the body hangs.
        gyro_scale_sigma: relative; it matters since the period depends on the angle, and is fitted with this prior.

    Raises:
        CalibrationError: too short, too wide, at rest, samples that are not finite, or no swing of a pendulum.
    """
    t, w = np.asarray(time_s, np.float64), np.asarray(rate_rad_s, np.float64)
    _check(t, w, suspension)
    t = t - t[0]
    start = _start(t, w, suspension)
    found, own, by_scale = _fitted(t, w, start, suspension, gyro_scale_sigma)
    inertia, viscous, _, angle, rate = found[:5].tolist()
    parts = {"swings": own / inertia, "gyro scale": abs(by_scale) * gyro_scale_sigma / inertia}
    parts |= suspension.relative_sigmas()
    omega = math.sqrt(suspension.stiffness() / inertia)
    amplitude = math.hypot(angle, rate / omega)
    if amplitude > LARGEST_ANGLE_rad:
        raise CalibrationError(f"the swing reaches {np.rad2deg(amplitude):.0f} deg; begin with less than 75 deg")
    return BifilarSwing(
        inertia,
        inertia * float(np.sqrt(sum(part**2 for part in parts.values()))),
        parts,
        float(start[0]),
        amplitude,
        2.0 * math.pi / omega,
        viscous * inertia,
        by_scale,
    )


def _check(t: FloatArray, w: FloatArray, suspension: Suspension) -> None:
    if t.ndim != 1 or t.shape != w.shape or len(t) < 50 or not (np.isfinite(t).all() and np.isfinite(w).all()):
        raise CalibrationError("give 50 or more finite samples of time and rate, of equal length")
    if not (np.diff(t) > 0.0).all() or float(np.diff(t).max()) > PAUSE * float(np.median(np.diff(t))):
        raise CalibrationError("the samples' times go back or have a gap; take a run without gaps")
    if not (min(suspension[:3]) > 0.0 and min(suspension[3:6]) >= 0.0 and suspension.gravity_m_s2 > 0.0):
        raise CalibrationError("mass, string spacing and length must be positive, their sigmas zero or more")


def _start(t: FloatArray, w: FloatArray, suspension: Suspension) -> FloatArray:
    """Start of the fit, ``[I, C / I, K_D / I, angle, rate, bias, scale]``, (7,), by the spectrum's peak."""
    bias = float(np.mean(w))
    even = np.linspace(t[0], t[-1], len(t))
    signal = np.interp(even, t, w - bias)
    frequency, power = periodogram(signal, 1.0 / (even[1] - even[0]), window="hann", nfft=8 * len(signal))
    at = float(frequency[1:][np.argmax(power[1:])])
    if at * (t[-1] - t[0]) < FEWEST_SWINGS:
        raise CalibrationError(f"{at * (t[-1] - t[0]):.1f} swings; record {FEWEST_SWINGS:.0f} or more")
    omega = 2.0 * np.pi * at
    few = t < 1.5 / at
    basis = np.column_stack([np.cos(omega * t), np.sin(omega * t), np.ones_like(t)])[few]
    cosine, sine, _ = np.linalg.lstsq(basis, w[few])[0]
    inertia = suspension.stiffness() / omega**2
    return np.array([inertia, 0.0, 0.0, -sine / omega, cosine, bias, 0.0])


def _fitted(
    t: FloatArray, w: FloatArray, start: FloatArray, suspension: Suspension, scale_sigma: float
) -> tuple[FloatArray, float, float]:
    """Parameters (6 or 7,); of the inertia, sigma by noise and slope by the gyro's scale.

    The residual is taken for the noise with its colour. As far as the swing does not tell the scale, which starts at
    zero with its sigma, the gyro's scale s is left in the result: ``-P_Is s / sigma^2``, P the covariance.
    """

    def residual(x: FloatArray) -> FloatArray:
        scale = float(x[6]) if scale_sigma else 0.0
        off = np.nan_to_num((1.0 + scale) * swung(x, span, suspension)[:, 1] + x[5] - seen, nan=1e3)
        return np.append(off, scale * noise / scale_sigma if scale_sigma else 0.0)

    def slopes(x: FloatArray) -> FloatArray:
        scale, known = (float(x[6]) if scale_sigma else 0.0), np.nan_to_num(swung(x, span, suspension, carried=True))
        out = np.zeros((len(span) + 1, x.size))
        out[:-1, :5], out[:-1, 5] = (1.0 + scale) * known[:, 3::2], 1.0
        if scale_sigma:
            out[:-1, 6], out[-1, 6] = known[:, 1], noise / scale_sigma
        return out

    size = float(np.sqrt(np.mean((w - w.mean()) ** 2)))
    omega = math.sqrt(suspension.stiffness() / start[0])
    noise = float(np.std(np.diff(w, 2))) / math.sqrt(6.0) + 1e-9 * size  # white part of the rate's
    unit = np.array([0.01 * start[0], 0.01 * omega, 0.1, 0.1 * size / omega, 0.1 * size, 0.1 * size, 0.01])
    x, swings = start[: 7 if scale_sigma else 6], 2.0
    while True:
        part = t < swings * 2.0 * np.pi / omega
        span, seen = t[part], w[part]
        fine = 1e-8 if part.all() else 1e-3  # relative; the next fit goes on from there
        found = least_squares(residual, x, slopes, x_scale=unit[: x.size], max_nfev=50, ftol=fine)
        x = np.asarray(found.x, np.float64)
        rms = float(np.sqrt(np.mean(found.fun[:-1] ** 2)))
        if not x[0] > 0.0 or rms > (WORST_RESIDUAL if part.all() else HOPELESS) * size:
            raise CalibrationError(
                f"{100.0 * rms / size:.1f} % of the rate is no pendulum's swing; let the body go without a push, and "
                "keep it from swinging sideways"
            )
        if part.all():
            break
        swings *= 2.0
    J = np.asarray(found.jac, np.float64)
    length = np.linalg.norm(J, axis=0)
    covariance = np.linalg.inv((J / length).T @ (J / length)) / np.outer(length, length)
    variance = float(found.fun @ found.fun) / (len(t) - x.size) * _colour(found.fun[:-1])
    if not scale_sigma:
        return x, float(np.sqrt(variance * covariance[0, 0])), 0.0
    left = float(covariance[0, 6]) * (noise / scale_sigma) ** 2  # the prior's row of J is noise / sigma
    by_noise = float(covariance[0, 0]) - float(covariance[0, 6]) ** 2 * (noise / scale_sigma) ** 2
    return x, float(np.sqrt(variance * by_noise)), -left


def swung(x: FloatArray, span: FloatArray, suspension: Suspension, *, carried: bool = False) -> FloatArray:
    """Angle, rate, and if ``carried`` their derivatives by ``x[:5]``, two each, at ``span`` (n,): (n, 2 or 12)."""
    m, h, g, square = suspension.mass_kg, suspension.length_m, suspension.gravity_m_s2, suspension.spacing_m**2
    inertia, viscous, quadratic, angle, rate = x[:5].tolist()

    def slope(state: FloatArray, _: float) -> tuple[float, ...]:
        th, om, *lean = state.tolist()
        cosine = math.cos(th)
        root = math.sqrt(max(h * h - 0.5 * square * (1.0 - cosine), 1e-6 * h * h))
        dz = 0.25 * square * math.sin(th) / root
        ddz = (0.25 * square * cosine + dz * dz) / root
        drag = (quadratic * abs(om) + viscous) * om
        whole = inertia + m * dz * dz
        up = -(m * dz * (g + ddz * om * om) + inertia * drag) / whole
        if not lean:
            return om, up
        dddz = dz * (3.0 * ddz / root - 1.0)
        by_th = -m * (ddz * (g + ddz * om * om) + dz * dddz * om * om + 2.0 * dz * ddz * up) / whole
        by_om = -(2.0 * m * dz * ddz * om + inertia * (2.0 * quadratic * abs(om) + viscous)) / whole
        by_inertia, by_viscous = -(drag + up) / whole, -inertia * om / whole
        a, da, b, db, c, dc, d, dd, e, de = lean
        return (
            *(om, up, da, by_th * a + by_om * da + by_inertia, db, by_th * b + by_om * db + by_viscous),
            *(dc, by_th * c + by_om * dc + by_viscous * abs(om), dd, by_th * d + by_om * dd, de),
            by_th * e + by_om * de,
        )

    begin = [angle, rate, *([0.0] * 6 + [1.0, 0.0, 0.0, 1.0] if carried else [])]
    limit = SENSITIVITY if carried else INTEGRATION
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ODEintWarning)  # a step too far is refused for what it leaves over
        return np.asarray(odeint(slope, begin, span, rtol=limit, atol=0.1 * limit), np.float64)


def _colour(residual: FloatArray) -> float:
    """By how much correlated noise widens what is averaged: the integrated autocorrelation (Sokal's window), >= 1."""
    n = len(residual)
    power = np.abs(np.fft.rfft(residual - residual.mean(), 2 * n)) ** 2
    rho = np.fft.irfft(power)[:n]
    rho = rho / rho[0]
    tau = np.cumsum(2.0 * rho) - 1.0
    window = np.flatnonzero(np.arange(n) > 5.0 * np.maximum(tau, 1.0))
    return float(max(1.0, tau[window[0] if window.size else -1]))


def inertia_tensor(
    axes: FloatArray, inertia_kg_m2: FloatArray, covariance_kg2_m4: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The tensor about the centre of mass from moments about axes through it: ``u' I u``, least squares.

    Args:
        axes: unit vectors in the body's axes, (k, 3); six or more for the products, not all in one cone.
        inertia_kg_m2: about each, (k,).
        covariance_kg2_m4: of these, with what the axes' errors do to them (:func:`axis_errors`), (k, k).

    Returns:
        The tensor (3, 3), and the covariance (6, 6) of xx, yy, zz, xy, xz, yz.

    Raises:
        CalibrationError: axes that do not determine all six elements, or moments that no rigid body has together.
    """
    tensor, covariance = _least_squares(axes, inertia_kg_m2, covariance_kg2_m4)
    moments = np.linalg.eigvalsh(tensor)
    slack = 3.0 * float(np.sqrt(covariance[:3, :3].trace()))
    if moments[0] <= 0.0 or moments[2] > moments[0] + moments[1] + slack:
        raise CalibrationError(f"principal moments {moments} are no rigid body's; check which axis each run was about")
    return tensor, covariance


def _least_squares(axes: FloatArray, values: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    u = _unit(axes)
    x, y, z = u.T
    root = np.linalg.cholesky(covariance)
    rows = np.linalg.solve(root, np.column_stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z]))
    if len(u) < 6 or np.linalg.matrix_rank(rows, 1e-6 * np.abs(rows).max()) < 6:
        raise CalibrationError("these axes do not determine six elements; swing about x, y, z and three axes between")
    of_elements = np.linalg.inv(rows.T @ rows)
    xx, yy, zz, xy, xz, yz = of_elements @ rows.T @ np.linalg.solve(root, np.asarray(values, np.float64))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), np.asarray(of_elements, np.float64)


def _unit(axes: FloatArray) -> FloatArray:
    u = np.asarray(axes, np.float64)
    return np.asarray(u / np.linalg.norm(u, axis=1, keepdims=True))


class AxisErrors(NamedTuple):
    """What makes a gyro show another axis than it turns about, 1 sigma; ``shown = (1 + E) true``, one E in all runs."""

    misalignment_rad: float  # of the gyro's axes in the body, about each: antisymmetric part of E
    scale: float = 0.0  # relative, each axis: diagonal of E
    cross_axis: float = 0.0  # each element off the diagonal

    def covariance(self) -> FloatArray:
        """Of the nine elements of E row by row, in the gyro's axes, (9, 9)."""
        diagonal = np.eye(3, dtype=bool).ravel()
        variance = np.where(diagonal, self.scale**2, self.misalignment_rad**2 + self.cross_axis**2)
        found = np.diag(variance)
        transposed = np.arange(9).reshape(3, 3).T.ravel()
        off = np.flatnonzero(~diagonal)
        found[off, transposed[off]] = -(self.misalignment_rad**2)
        return found


def axis_errors(
    axes: FloatArray,
    inertia_kg_m2: FloatArray,
    own_kg_m2: FloatArray,
    by_scale_kg_m2: FloatArray,
    errors: AxisErrors,
    sway: FloatArray,
    R_BS: FloatArray,
) -> FloatArray:
    """Covariance (k, k) of the moments as moments about the axes that the gyro showed.

    About u, shown as ``v = (1 + E) u / |(1 + E) u|``, the moment ``u' I u`` is ``v' I v - 2 (I u - (u' I u) u)' E u``
    to first order, and the scale ``u' E u`` moves it by ``by_scale``. E is the same in every run: it turns the tensor
    found, and its products take up differences of the moments. A sway sideways tilts the axis shown of one run alone.

    Args:
        axes: as :func:`inertia_tensor`.
        inertia_kg_m2: about each, (k,).
        own_kg_m2: sigma of each by its own swing, (k,).
        by_scale_kg_m2: of each by the gyro's scale (:class:`BifilarSwing`), (k,).
        errors: of the gyro's axes.
        sway: rate across the axis over that about it, (k,).
        R_BS: rotation from the gyro's axes to the body's, (3, 3).

    Raises:
        CalibrationError: axes that do not determine all six elements.
    """
    u, values, own = _unit(axes), np.asarray(inertia_kg_m2, np.float64), np.diag(np.square(own_kg_m2))
    tensor, _ = _least_squares(u, values, own)
    across = 2.0 * (u @ tensor - values[:, None] * u)
    moved = np.asarray(by_scale_kg_m2)[:, None] * u - across
    slopes = np.einsum("ki,kj->kij", moved @ R_BS, u @ R_BS).reshape(len(u), 9)
    tilted = np.diag(np.square(np.linalg.norm(across, axis=1) * sway))
    return np.asarray(own + tilted + slopes @ errors.covariance() @ slopes.T, np.float64)
