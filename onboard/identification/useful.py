"""Whether an estimate is known well enough to be used: half its interval against a size.

A mass or a moment of inertia is held against itself, a product of inertia against the largest moment of its body, a
coordinate of a centre of mass against the size of the body: ``(|c|^2 + tr I / 2 m)^(1/2)``, the root mean square
distance of its mass from the origin of its frame. A body of which mass or inertia is not determined has no size, and
its products and centre are not judged. What is useful is stated by the user (``[estimation.useful]``).
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from onboard.identification.quantities import BODY, QuantityEstimate

_CENTRE, _MOMENTS, _PRODUCTS = ("c_x", "c_y", "c_z"), ("I_xx", "I_yy", "I_zz"), ("I_xy", "I_xz", "I_yz")


class Useful(NamedTuple):
    """Half an interval over what it is held against, at most; by default what a controller of the pair needs."""

    mass: float = 0.2
    moment: float = 0.2
    product: float = 0.2
    centre: float = 0.1


class Size(NamedTuple):
    """What half an interval is held against."""

    value: float
    share: float  # of it, at most
    what: str  # "it", "the body's size", "its largest moment"


def is_positive(name: str, unit: str) -> bool:
    """Whether a quantity is a mass or a moment of inertia, and no product of inertia."""
    return unit == "kg" or (unit == "kg m^2" and not name.startswith(_PRODUCTS))


def sizes(quantities: Iterable[QuantityEstimate], useful: Useful) -> dict[str, Size]:
    """By name, of the quantities that have one."""
    told = {one.name: one for one in quantities if one.supported}
    found = {
        name: Size(one.value, useful.mass if one.unit == "kg" else useful.moment, "it")
        for name, one in told.items()
        if is_positive(name, one.unit)
    }
    for name in [name for name in told if name.startswith(f"{BODY[0]}_")]:
        body = name.removeprefix(BODY[0])
        of = {kind: told.get(kind + body) for kind in BODY}
        moments = [one.value for kind in _MOMENTS if (one := of[kind]) is not None]
        if not moments:
            continue
        for kind in _PRODUCTS:
            found[kind + body] = Size(max(moments), useful.product, "its largest moment")
        centre = [one.value for kind in _CENTRE if (one := of[kind]) is not None]
        if len(moments) == 3 and sum(moments) > 0.0 < told[name].value:
            size = float(np.sqrt(np.dot(centre, centre) + sum(moments) / 2.0 / told[name].value))
            for kind in _CENTRE:
                found[kind + body] = Size(size, useful.centre, "the body's size")
    return found


def too_wide(one: QuantityEstimate, size: Size | None) -> str:
    """Why an answer is not known well enough; empty if it is, or has no size."""
    if size is None or one.half <= size.share * size.value:
        return ""
    return f"its interval is as wide as {one.half / size.value:.0%} of {size.what}"
