"""Maximum likelihood fit of a body on a pivot: what its IMU shows, predicted from what its wheels do.

Unknown are the body (first moment and inertia about the pivot), errors of wheels, IMU and bearing within their stated
sigmas, and for every window of :data:`WINDOW_s` rate and attitude at its first tick, so that an unknown torque of the
bearing does not accumulate. No reading shows the wheels' inertia, and all estimates of the body scale with it.

Derivatives of the motion are differences of its prediction, all variants integrated at once; those of the IMU's errors
are :func:`onboard.identification.free_flyer.prediction.imu_errors.imu_reading`'s. Intervals are widened by what is left
over of each sensor, and by the scatter of the windows' scores
(:func:`onboard.estimation.recursive.consistency.noise_scale`).

The fit starts from the balance of the body's momentum. Over a second ``J w + h`` changes by the integral of ``g u x c -
w x (J w + h)``, with rate w and vertical u as they are read: linear in first moment c and inertia J. No drawing has to
be near. That matters where a drawing leaves out what balances a wheel: within a window such a body swings to where no
step leads back from.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.inertia import composite_functional, symmetric
from onboard.dynamics.model.vehicle import STANDARD_GRAVITY_M_S2, VehicleModel
from onboard.dynamics.pivot import PivotBody, predict_pivot, specific_force
from onboard.estimation.arrays import BoolArray, FloatArray, gaps
from onboard.estimation.errors import ConvergenceError
from onboard.estimation.maximum_likelihood import MINIMUM, Fit, Normal, fit_normal, inverse_of
from onboard.estimation.recursive.consistency import NoiseScale
from onboard.identification.free_flyer.prediction.imu_errors import (
    ImuPrior,
    gain_of,
    imu_blocks,
    imu_reading,
    tick_mean,
)
from onboard.identification.free_flyer.prediction.parameters import GeometryPrior, UnknownLayout, Unknowns
from onboard.identification.free_flyer.prediction.ticks import Ticks
from onboard.identification.quantities import inertia_about_joint
from onboard.identification.windows import SHORTEST, Part, WINDOW_s, WindowedFit, judged, total

_BASIS = np.stack([symmetric(one) for one in np.eye(6)], axis=2)  # (3, 3, 6)


def by_momentum(
    motion: tuple[FloatArray, FloatArray, FloatArray],
    whole: BoolArray,
    proof: FloatArray,
    beforehand: tuple[FloatArray, FloatArray],
    noise: float,
    g: float,
    period_s: float,
) -> FloatArray:
    """First moment and inertia about the pivot, (9,): XX XY YY XZ YZ ZZ.

    Args:
        motion: rate rad/s, specific force m/s^2, what the wheels store N m s, each (k, n, 3), body axes, over k spans.
        whole: (k,) which spans were measured without a gap.
        proof: (k, 9) the same numbers of what is known to be set on.
        beforehand: mean and sigma, (9,) each.
        noise: of a momentum, N m s.
        g: m/s^2.
        period_s: between ticks.
    """
    w, f, h = (one[whole] for one in motion)
    u = f / np.linalg.norm(f, axis=2, keepdims=True)
    spin = np.einsum("ijm,knj->knim", _BASIS, w)
    lever = -np.cross(np.eye(3), u[:, :, None])  # (k, n, 3, 3): row i is u x e_i
    torque = np.concatenate([g * lever.swapaxes(2, 3), -np.cross(w[..., None], spin, 2, 2, 2)], axis=3)
    gained = np.concatenate([np.zeros((*w.shape, 3)), spin], axis=3)
    A = gained[:, -1] - gained[:, 0] - np.trapezoid(torque, dx=period_s, axis=1)
    b = h[:, 0] - h[:, -1] - np.trapezoid(np.cross(w, h), dx=period_s, axis=1)
    b -= np.einsum("kim,km->ki", A, proof[whole])
    mean, sigma = beforehand
    A, b = A.reshape(-1, 9) * sigma / noise, (b - A @ mean).ravel() / noise
    return np.asarray(mean + sigma * np.linalg.solve(A.T @ A + np.eye(9), A.T @ b), np.float64)


BODY = 9  # unknowns: first moment, inertia
_STATE = 5  # unknowns of a window: rate, tilt at its first tick


class Windows(NamedTuple):
    """Ticks in windows of equal length, (k, n, ...); what is behind a shorter one's end is not measured."""

    time_s: FloatArray
    speed: FloatArray  # (k, n, wheels) rad/s
    change: FloatArray  # its derivative
    measured: FloatArray  # (k, n, 6) means of rate and specific force, IMU axes
    sigma: FloatArray
    use: BoolArray  # (k, n, 2) gyro, accelerometer
    rate: FloatArray  # (k, 3) as measured at the first tick, body axes
    up: FloatArray  # (k, 3) the same of the unit vector up
    across: FloatArray  # (k, 3, 2) unit vectors across that
    held: BoolArray  # (k,) the proof mass is
    inside: BoolArray  # (k, n) not behind the window's end


class PivotModel:
    """Predicts the IMU of a body on a pivot.

    Args:
        vehicle: its joints turn balanced wheels; its drawing is the first guess, and gives the size of what is known of
            the body beforehand: nothing.
        imu_frame: fixed in the base.
        period_s: between ticks.
        samples: of the IMU in each.
        imu_prior: on its errors.
        geometry: on its place, and on scale and delay of the wheels.
        bearing: sigmas of drag, N m s, and of the jets' torque, N m.
        per_g_rad_s: sigma of each element of what 1 g adds to the gyro's readings.
        proof_sigma: relative, of the payload link as it is drawn: a known mass that is attached for a part of the run.

    Attributes:
        names: of the unknowns but the windows'.
        sigma: of these beforehand, about the drawing and about no error.
        mass_kg: of all links.
        p_BoSo_B: place of the IMU, (3,).
        proof: first moments and inertia of the known mass, (9,).
        stored: axial inertia of the wheels along their axes, (wheels, 3).
    """

    def __init__(
        self,
        vehicle: VehicleModel,
        imu_frame: str,
        period_s: float,
        samples: int,
        imu_prior: ImuPrior,
        geometry: GeometryPrior,
        bearing: tuple[float, float],
        per_g_rad_s: float = 0.0,
        proof_sigma: float = 0.0,
    ) -> None:
        self._period_s, self._samples = period_s, samples
        self._g = float(np.linalg.norm(vehicle.spec.gravity_m_s2))
        self._R_BS, self.p_BoSo_B = vehicle.pose_in_base(imu_frame)
        own, functional = vehicle.payload_columns(), composite_functional(vehicle)
        self.proof = functional[1:, own] @ vehicle.chi[own]
        whole = functional @ vehicle.chi - np.append(vehicle.chi[own][:1].sum(), self.proof)
        self.mass_kg, self._drawn = float(whole[0]), whole[1:]
        half_trace = 0.5 * float(np.trace(symmetric(whole[4:])))
        wide = [*[float(np.sqrt(half_trace * whole[0]))] * 3, *[half_trace] * 6]
        joints = geometry.of(vehicle)
        names = [joint.name for joint in vehicle.joints]
        axes = (vehicle.tree.seat_axes @ vehicle.tree.axis[..., None])[..., 0]  # (wheels, 3)
        axial = [float((inertia_about_joint(vehicle, name) @ vehicle.chi).sum()) for name in names]
        self.stored = axes * np.array(axial)[:, None]
        body = [f"moment_{axis}" for axis in "xyz"] + [f"inertia_{of}" for of in ("xx", "xy", "yy", "xz", "yz", "zz")]
        blocks = {
            "body": Unknowns(tuple(body), np.array(wide)),
            "wheels": Unknowns(
                (*(f"scale_{name}" for name in names), *(f"delay_{name}" for name in names)),
                np.array([*(one.scale for one in joints), *(one.delay_s for one in joints)]),
            ),
            "proof": Unknowns(("proof",), np.array([proof_sigma * (own.stop > own.start)])),
            "bearing": Unknowns(("drag", "jets"), np.array(bearing)),
            "place": Unknowns(tuple(f"place_{axis}" for axis in "xyz"), np.full(3, geometry.imu_place_m)),
        }
        self._moving = sum(len(block.names) for block in blocks.values())
        per_g = tuple(f"gyro_per_g_{row}{column}" for row in "xyz" for column in "xyz")
        errors = imu_blocks(imu_prior._replace(clock_rate_error=0.0))
        self._layout = UnknownLayout(blocks | errors | {"per_g": Unknowns(per_g, np.full(9, per_g_rad_s))})
        self.names, self.sigma = self._layout.names, self._layout.sigma

    def body(self, x: FloatArray) -> FloatArray:
        """First moment and inertia about the pivot, (9,): XX XY YY XZ YZ ZZ."""
        return np.asarray(self._drawn + x[:BODY], np.float64)

    def fit(self, ticks: Ticks, held: BoolArray, start: FloatArray | None = None) -> WindowedFit:
        """The unknowns that explain the ticks best.

        Args:
            ticks: in the order of their times.
            held: whether the proof mass is attached, (n,).
            start: unknowns but the windows', where an earlier fit was near; where not given, the body by its momentum.

        Raises:
            EstimationError: too few ticks, or no minimum.
        """
        windows = windows_of(ticks, held, self._period_s, self._R_BS)
        p, k = len(self.names), len(windows.time_s)
        x = np.zeros(p + _STATE * k)
        x[:p] = self._begun(windows) if start is None else start
        x[p:].reshape(k, _STATE)[:, :3] = windows.rate
        prior = np.diag(np.concatenate([self.sigma**-2, np.zeros(_STATE * k)]))
        asked = (lambda at: self._total(at, windows)), x, np.zeros_like(x), prior
        try:
            found = fit_normal(*asked, tolerance=MINIMUM)
        except ConvergenceError:  # of an IMU that is not as stated, say: the drawing may be nearer, and tells what is
            x[:p] = 0.0
            found = fit_normal(*asked, tolerance=MINIMUM)
        return judged(found, self._residuals(found.x, windows), p, 2)

    def bound(self, ticks: Ticks, held: BoolArray, rate: FloatArray) -> WindowedFit:
        """What ticks can tell of the body as it is drawn, its IMU's readings predicted: the Cramér-Rao bound.

        Args:
            ticks: as of :meth:`fit`; what they measured does not count.
            held: as of :meth:`fit`; the motion is that without the proof mass.
            rate: at the first tick, where it stands upright, (3,) rad/s.

        Raises:
            EstimationError: too few ticks, or a motion that leaves something open.
        """
        n, p, upright = len(ticks.time_s), len(self.names), np.array([[0.0, 0.0, 1.0]])
        time_s, dq, ddq, measured, sigma = (part[None] for part in (ticks.time_s, ticks.dq, ticks.ddq, *ticks[4:6]))
        all_of_it, across, none = np.ones((1, n), np.bool_), np.eye(3)[None, :, :2], np.zeros(1, np.bool_)
        begun = rate[None], upright, across, none, all_of_it
        whole = Windows(time_s, dq, ddq, measured, sigma, np.ones((1, n, 2), np.bool_), *begun)
        begin = np.append(rate, np.zeros(2))[None, None]
        shown = self._true(np.zeros((1, self._moving)), begin, whole)[0, 0]
        windows = windows_of(ticks._replace(measured=shown), held, self._period_s, self._R_BS)
        x = np.zeros(p + _STATE * len(windows.time_s))
        x[p:].reshape(-1, _STATE)[:, :3] = windows.rate
        prior = np.concatenate([self.sigma**-2, np.zeros(x.size - p)])
        covariance = inverse_of(self._total(x, windows).information + np.diag(prior))
        return WindowedFit(
            Fit(x, covariance, 0.0, 0), p, (1.0, 1.0), NoiseScale(1.0, np.inf), 3 * int(windows.use.sum())
        )

    def _begun(self, windows: Windows) -> FloatArray:
        """Unknowns but the windows', where nothing is known: the body by its momentum in each second, nothing wrong."""
        n = SHORTEST + 1
        spans = range(0, windows.time_s.shape[1] - n + 1, n - 1)
        rate, felt = (windows.measured[..., axes] @ self._R_BS.T for axes in (slice(3), slice(3, 6)))
        parts = rate, felt, windows.speed @ self.stored
        motion = tuple(np.concatenate([part[:, first : first + n] for first in spans]) for part in parts)
        whole = np.concatenate([windows.use[:, first : first + n].all(axis=(1, 2)) for first in spans])
        proof = np.tile(windows.held[:, None] * self.proof, (len(spans), 1))
        beforehand = np.append(np.zeros(3), self._drawn[3:]), self.sigma[:BODY]
        noise = float(windows.sigma[..., :3].mean() * self._drawn[[3, 5, 8]].sum())
        x = np.zeros(len(self.names))
        x[:BODY] = by_momentum(
            (motion[0], motion[1], motion[2]), whole, proof, beforehand, noise, self._g, self._period_s
        )
        x[:BODY] -= self._drawn
        return x

    def residuals(self, ticks: Ticks, held: BoolArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Times of the ticks in windows, (n,), and predicted less measured in sigmas, (n, 6); NaN: not used."""
        windows = windows_of(ticks, held, self._period_s, self._R_BS)
        left = np.full(windows.measured.shape, np.nan)
        for k, (r, _, _) in enumerate(self._residuals(x, windows)):
            left[k][np.repeat(windows.use[k], 3, axis=1)] = r
        inside = windows.inside
        return ticks.time_s[0] + windows.time_s[inside], left[inside]

    def _total(self, x: FloatArray, windows: Windows) -> Normal:
        return total(self._residuals(x, windows), len(self.names), x.size)

    def _residuals(self, x: FloatArray, windows: Windows) -> Iterator[Part]:
        """Of each window: whitened residuals (u,), their derivative (u, p + state), and the sensor of each, 0 or 1."""
        p, D, steps = len(self.names), self._moving, self._steps
        every = self._layout.whole(x[:p])
        states = x[p:].reshape(-1, _STATE)
        moving = np.tile(every[:D], (1 + D + _STATE, 1))
        moving[1 : 1 + D] += np.diag(steps[:D])
        begin = np.tile(states, (1 + D + _STATE, 1, 1))
        begin[1 + D :] += np.diag(steps[D:])[:, None]
        true = self._true(moving, begin, windows)  # (b, k, n, 6) IMU axes
        slope = np.gradient(true[0], self._period_s, axis=1)
        (errors, per_g), kept = np.split(every[D:], [-9]), self._layout.kept
        apart = ((true[1:] - true[0]) / steps[:, None, None, None]) @ gain_of(errors).T  # (D + state, k, n, 6)
        for k, time_s in enumerate(windows.time_s):
            shown = imu_reading(true[0, k], slope[k], time_s, errors)
            felt = true[0, k, :, 3:] / STANDARD_GRAVITY_M_S2
            by_g = np.pad(np.einsum("ij,nk->nijk", np.eye(3), felt).reshape(-1, 3, 9), [(0, 0), (0, 3), (0, 0)])
            J = np.concatenate([np.moveaxis(apart[:D, k], 0, 2), shown.d_errors, by_g], axis=2)[..., kept]
            J = np.concatenate([J, np.moveaxis(apart[D:, k], 0, 2)], axis=2)
            use, sigma = np.repeat(windows.use[k], 3, axis=1), windows.sigma[k]
            r = ((shown.values + by_g @ per_g - windows.measured[k]) / sigma)[use]
            yield Part(r, (J / sigma[..., None])[use], np.broadcast_to(np.arange(6) // 3, use.shape)[use])

    def _true(self, moving: FloatArray, begin: FloatArray, windows: Windows) -> FloatArray:
        """Means over ticks of rate and specific force at the IMU, its axes, (b, k, n, 6), of b variants.

        Args:
            moving: of body, wheels, bearing and place, (b, D).
            begin: of rate and tilt at each window's first tick, (b, k, state).
            windows: k of them.
        """
        chi = self._drawn + moving[:, :BODY]
        scale, delay = np.split(moving[:, BODY : BODY + 2 * len(self.stored)], 2, axis=1)  # (b, wheels)
        drag, jets = moving[:, -5], moving[:, -4]
        proof = windows.held[:, None] * (1.0 + moving[:, -6, None, None]) * self.proof  # (b, k, 9)
        both = np.moveaxis(chi[:, None] + proof, 2, 0)
        body = PivotBody(np.moveaxis(symmetric(both[3:]), (0, 1), (2, 3)), both[:3], drag, jets)
        onto = (1.0 + scale)[:, :, None] * self.stored  # (b, wheels, 3)
        late = -delay[:, :, None] * onto
        stored, change = (np.einsum("bwi,knw->nibk", onto, of) for of in (windows.speed, windows.change))
        stored = stored + np.einsum("bwi,knw->nibk", late, windows.change)
        tilt = np.einsum("kij,bkj->ibk", windows.across, begin[:, :, 3:]) + windows.up.T[:, None]
        up = tilt / np.linalg.norm(tilt, axis=0)
        motion = predict_pivot(body, stored, change, begin[:, :, :3].transpose(2, 0, 1), up, self._g, self._period_s)
        felt = specific_force(motion, self.p_BoSo_B[:, None] + moving[:, -3:].T, self._g)
        shown = [np.einsum("ji,njbk->nbki", self._R_BS, one) for one in (motion.rate, felt)]
        return np.moveaxis(tick_mean(np.concatenate(shown, axis=3), self._samples), 0, 2)

    @property
    def _steps(self) -> FloatArray:
        """Of the differences, of all that moves the body, then of a window's state."""
        k = len(self.stored)
        body = [*[1e-6 * self.mass_kg] * 3, *[1e-6 * float(self._drawn[[3, 5, 8]].sum())] * 6]
        return np.array([*body, *[1e-5] * k, *[1e-6] * k, 1e-5, *[1e-6] * 2, *[1e-5] * 3, *[1e-6] * _STATE])


def windows_of(ticks: Ticks, held: BoolArray, period_s: float, R_BS: FloatArray) -> Windows:
    """Ticks in succession in windows, each beginning with a tick that both sensors measured.

    Args:
        ticks: in the order of their times; joints NaN where nothing is known of them.
        held: whether the proof mass is attached, (n,).
        period_s: between them.
        R_BS: rotation of the IMU's axes to the body's.

    Raises:
        ConvergenceError: there is none.
    """
    most = max(SHORTEST, round(WINDOW_s / period_s))
    known = np.asarray(np.isfinite(np.hstack([ticks.dq, ticks.ddq])).all(axis=1), np.bool_)
    use = np.asarray(np.isfinite(ticks.measured.reshape(-1, 2, 3)).all(axis=2) & known[:, None], np.bool_)
    apart = (held[1:] != held[:-1]) | ~known[1:] | ~known[:-1] | gaps(ticks.time_s, period_s)
    parts, first = list[slice](), 0
    for end in (*(np.flatnonzero(apart) + 1).tolist(), len(known)):
        while end - first >= SHORTEST:
            if use[first].all():
                parts.append(slice(first, min(first + most, end)))
                first = parts[-1].stop
            else:
                first += 1
        first = end
    if not parts:
        raise ConvergenceError(f"no {SHORTEST * period_s:g} s of IMU and wheels in succession")

    def stacked(values: FloatArray) -> FloatArray:
        return np.array([np.pad(values[p], [(0, most - p.stop + p.start), (0, 0)], "edge") for p in parts])

    inside = np.arange(most) < np.array([p.stop - p.start for p in parts])[:, None]
    used = np.array([np.pad(use[p], [(0, most - p.stop + p.start), (0, 0)]) for p in parts]) & inside[..., None]
    begins = np.array([ticks.measured[p.start] for p in parts])
    up = begins[:, 3:] @ R_BS.T
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    across = np.linalg.svd(up[:, None])[2][:, 1:].swapaxes(1, 2)  # (k, 3, 2)
    time_s = stacked(ticks.time_s[:, None] - ticks.time_s[0])[..., 0]
    measured, sigma = (np.where(np.isfinite(of), of, 1.0) for of in (stacked(ticks.measured), stacked(ticks.sigma)))
    begun = begins[:, :3] @ R_BS.T, up, across, held[[p.start for p in parts]], inside
    return Windows(time_s, stacked(ticks.dq), stacked(ticks.ddq), measured, sigma, used, *begun)
