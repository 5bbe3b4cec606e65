"""``[free_body]``: a free vehicle identified as one rigid body, and its possible loads."""

from typing import Literal

from pydantic import Field

from onboard.section import NotNegative, Positive, Section, Sigma3, Sigma6, Vector3, Vector6


class Carrier(Section):
    """The device itself, without a load, in base axes, with the sigmas of its calibration.

    Inertia is about its own centre of mass, in the order XX, XY, YY, XZ, YZ, ZZ.
    """

    mass_kg: Positive
    centre_of_mass_m: Vector3
    centre_of_mass_sigma_m: Sigma3
    inertia_kg_m2: Vector6
    inertia_sigma_kg_m2: Sigma6


class Load(Section):
    """A weighed load of a free body, in some of its logs.

    ``role``: "carrier" is the device alone (``mass_kg`` is the carrier's), "proof" a body known beforehand, its
    ``truth_kg_m2`` about the base axes x, y, z through its own centre of mass; these two calibrate. ``truth_kg_m2``
    of a "load" are principal moments in any order. ``bars_percent``: the mean and the worst error that are accepted.
    """

    name: str
    logs: str
    role: Literal["load", "carrier", "proof"] = "load"
    mass_kg: Positive
    truth_kg_m2: tuple[Positive, Positive, Positive] | None = None
    truth_source: str | None = None
    bars_percent: tuple[Positive, Positive] | None = None


class FreeBody(Section):
    """A free vehicle with balanced rotors, identified as one rigid body: its carrier and its possible loads.

    ``rotor_sigma``: relative, of the rotors' inertia in the URDF; all inertias scale with it.
    """

    rotor_sigma: NotNegative = 0.0
    carrier: Carrier | None = None
    load: list[Load] = Field(default_factory=list)
