"""Predicts the motion of a body without joints on a table: x, y and yaw of its centre of mass.

With F the force of its thrusters in its own axes, M their moment about the centre of mass, R the rotation by the yaw:

    m dv/dt = R F + m (a - b v),    I dw/dt = M + I (e - s w)

a, e: steady accelerations that nothing states (the table's tilt, a draught); b, s: drag over mass and over inertia.
"""

from typing import NamedTuple

import numpy as np

from onboard.estimation.arrays import FloatArray


class Floating(NamedTuple):
    """What moves b variants of a body in k windows of n steps."""

    force: FloatArray  # (n, 2, b, k) mean over each step, over the mass, body axes, m/s^2
    turning: FloatArray  # (n, b, k) moment over inertia, rad/s^2
    ahead: FloatArray  # (n, 3, b, k) of x, y (body axes) and yaw, after each step beyond what the means make: m, rad
    steady: FloatArray  # (3, b, k) a, of the table's axes, and e
    drag: FloatArray  # (2, b, 1) b and s, 1/s


def predict_floating(body: Floating, state: FloatArray, period_s: float) -> FloatArray:
    """States after none to n steps, (n + 1, 6, b, k): x, y, yaw and their rates.

    The acceleration is that at the middle of each step, which is exact to the square of the step. Forces that change
    within a step leave the body elsewhere than their means do; without ``ahead`` a state would have a kink where the
    time of such a change comes to the end of a step.

    Args:
        body: what moves it.
        state: at the start, (6, b, k).
        period_s: of a step.
    """
    n, h = len(body.force), period_s
    states = np.empty((n + 1, *state.shape))
    states[0] = state
    rates, ahead = np.empty((2, 3, *state.shape[1:]))
    for i in range(n):
        now = states[i]
        turned = body.turning[i] + body.steady[2] - body.drag[1] * now[5]
        middle = now[2] + 0.5 * h * now[5] + 0.125 * h * h * turned
        c, s = np.cos(middle), np.sin(middle)
        fx, fy = body.force[i]
        rates[0], rates[1], rates[2] = c * fx - s * fy, s * fx + c * fy, turned
        rates[:2] += body.steady[:2]
        rates[:2] -= body.drag[0] * now[3:5]
        ax, ay, ahead[2] = body.ahead[i]
        ahead[0], ahead[1] = c * ax - s * ay, s * ax + c * ay
        states[i + 1, :3] = now[:3] + h * now[3:] + 0.5 * h * h * rates + ahead
        states[i + 1, 3:] = now[3:] + h * rates
    return states
