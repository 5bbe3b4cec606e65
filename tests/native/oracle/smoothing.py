"""Samples under a smoothing kernel, and what the kernel makes of them: the equations of ``smoothing.c``."""

import numpy as np


def under(times, at, low, high, width_s, gap_s):
    """Places in widths (n, l), quadrature weights (n, l), and whether no gap is longer, (n,)."""
    length, last = max(int((high - low).max()), 1), len(times) - 1
    index = low[:, None] + np.arange(length)
    inside = index < high[:, None]
    t = times[np.minimum(index, last)]
    cell = np.gradient(times, np.arange(len(times)))
    u = np.where(inside, (t - at[:, None]) / width_s, 0.0)
    cells = np.where(inside, cell[np.minimum(index, last)] / width_s, 0.0)
    steps = np.where(inside[:, 1:], np.diff(t, axis=1), 0.0).max(axis=1, initial=0.0)
    edges = np.maximum(t[:, 0] - (at - 0.5 * width_s), at + 0.5 * width_s - times[np.maximum(high, 1) - 1])
    return u, cells, (high > low) & (np.maximum(steps, edges) <= gap_s)


def pieces(coefficients, u):
    """Polynomials on intervals of -1/2..1/2, zero beyond, (functions, ...); coefficients (powers, functions, k)."""
    place = (u + 0.5) * coefficients.shape[2]
    interval = np.clip(place, 0.0, coefficients.shape[2] - 1.0).astype(np.intp)
    place = place - interval
    value, inside = np.zeros((coefficients.shape[1], *u.shape)), (place >= 0.0) & (place <= 1.0)
    for coefficient in coefficients[::-1]:
        value = value * place + coefficient[:, interval]
    return np.where(inside, value, 0.0)


def kernels(u, cell, shapes):
    """Kernel and derivatives with weights (n, 3, l), powers of the places (n, l, 3), and these weighted."""
    near, *of_kernel = shapes
    powers = np.stack([np.ones_like(u), u, u * u], axis=2)
    signs = np.array([1.0, -1.0, 1.0])[:, None]
    return np.stack(of_kernel, axis=1) * (signs * cell[:, None]), powers, powers * (near * cell)[..., None]


def weights(u, cell, shapes, of_powers, width_s):
    """Weights of value and two derivatives, (n, 3, l): the kernel's with the smallest correction of its moments."""
    of_kernel, powers, weighted = kernels(u, cell, shapes)
    correctors = weighted @ np.linalg.inv(weighted.swapaxes(1, 2) @ powers)
    raw = of_kernel + (of_powers - of_kernel @ powers) @ correctors.swapaxes(1, 2)
    return raw / width_s ** np.arange(3.0)[:, None]
