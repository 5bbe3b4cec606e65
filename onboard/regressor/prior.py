"""What is known of standard parameters beforehand, as a root L of their covariance ``L L'``.

A link that was weighed, balanced and swung is off in mass, centre of mass and inertia about it, each by itself. Its
parameters are about the link's frame, so these errors move several of them at once: a centre that is off moves first
moments and inertia together. Sigmas by parameter (:func:`named_relative_sigma`) leave each an error of its own.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from onboard.dynamics.model.errors import UnknownFrameError, UrdfError
from onboard.dynamics.model.payload import standard_root
from onboard.estimation.arrays import FloatArray
from onboard.regressor.base_parameters import named_relative_sigma
from onboard.regressor.rows import RowModel


class LinkSigmas(NamedTuple):
    """How well a link is known, 1 sigma."""

    mass_relative: float
    centre_m: float  # of each coordinate of the centre of mass
    inertia_relative: float  # of each element about the centre of mass, of half that tensor's trace


def prior_root(
    model: RowModel,
    relative: Mapping[str, float],
    extras: Mapping[str, float],
    made: Mapping[str, LinkSigmas] | None = None,
) -> FloatArray:
    """L, (P, P): by link relative or as it was made, by name absolute for the other columns.

    Args:
        model: gives the columns.
        relative: sigma of all of a link's parameters (:meth:`Vehicle.parameter_sigma`), by link.
        extras: absolute sigma by column name (:func:`named_relative_sigma`).
        made: links that are not in ``relative``.

    Raises:
        UnknownFrameError: a link or column that is missing, unknown, or stated twice.
        UrdfError: a link without mass, of which the sigma would fix its parameters silently.
        SignalError: a sigma that is negative or not finite.
    """
    vehicle, made = model.vehicle, made or {}
    for link in made:
        if link not in vehicle.links:
            raise UnknownFrameError(f"the prior names {link!r}; links with inertia are {', '.join(vehicle.links)}")
        if link in relative:
            raise UnknownFrameError(f"link {link!r} has an absolute and a relative sigma; state either")
    root = np.diag(named_relative_sigma(model, {**dict.fromkeys(made, 0.0), **relative}, extras))
    for index, link in enumerate(vehicle.links):
        own = slice(10 * index, 10 * index + 10)
        if link not in made:
            _check(link, relative[link], root[own])
            continue
        if named := sorted(set(model.names[own]) & set(extras)):
            raise UnknownFrameError(f"{named[0]} has an absolute sigma beside that of its link {link!r}; state either")
        if not model.chi[own.start] > 0.0:
            raise UrdfError(
                f"link {link!r} has no mass in the URDF for its sigma; give it a mass, or take the sigma out"
            )
        root[own, own] = standard_root(model.chi[own], *made[link])
    return root


def _check(link: str, relative: float, root: FloatArray) -> None:
    if relative > 0.0 and not root[0].any():  # of a point the rest is as drawn
        text = f"link {link!r} has no mass in the URDF that a relative sigma could be of"
        raise UrdfError(f"{text}; give absolute sigmas, M_{link} to ZZ_{link}, or a relative sigma of 0 if it is exact")
