"""Half an interval against a size: of itself, of the body, of its largest moment."""

import numpy as np
import pytest

from onboard.identification.quantities import BODY, BODY_UNITS, QuantityEstimate, Useful, sizes, too_wide

VALUES = (2.0, 0.1, 0.0, -0.2, 0.02, 0.001, 0.03, 0.0, 0.0, 0.01)
ROOT_MEAN_SQUARE = np.sqrt(0.1**2 + 0.2**2 + 0.06 / 2.0 / 2.0)  # m, of the distance of its mass from the origin


def body(halves: dict[str, float], untold: tuple[str, ...] = ()) -> list[QuantityEstimate]:
    """The ten numbers of a body, with half intervals; a hundredth of its value where none is given."""
    found = []
    for name, unit, value in zip(BODY, BODY_UNITS, VALUES, strict=True):
        half = halves.get(name, 0.01 * abs(value))
        numbers = value, half / 2.0, value - half, value + half
        found.append(QuantityEstimate(f"{name}_box", unit, *numbers, name not in untold, shrinkage=0.01))
    return found


@pytest.mark.parametrize(
    ("name", "size", "share", "what"),
    [
        ("m", 2.0, 0.2, "it"),
        ("I_xx", 0.02, 0.2, "it"),
        ("I_xy", 0.03, 0.2, "its largest moment"),
        ("I_yz", 0.03, 0.2, "its largest moment"),
        ("c_y", ROOT_MEAN_SQUARE, 0.1, "the body's size"),
    ],
)
def test_an_interval_is_held_against_a_size(name, size, share, what):
    for factor, wide in ((0.99, False), (1.01, True)):
        half = factor * share * size
        found = body({name: half})
        said = {one.name: too_wide(one, sizes(found, Useful()).get(one.name)) for one in found}
        assert {of for of, why in said.items() if why} == ({f"{name}_box"} if wide else set())
        assert not wide or said[f"{name}_box"] == f"its interval is as wide as {half / size:.0%} of {what}"


def test_a_body_without_a_size_has_no_limits_of_its_centre():
    found = body({"c_z": 10.0, "I_xy": 10.0}, untold=("I_xx", "I_yy", "I_zz"))
    assert set(sizes(found, Useful())) == {"m_box"}
    assert set(sizes(body({}, untold=("m",)), Useful())) == {"I_xx_box", "I_yy_box", "I_zz_box"}
    assert too_wide(found[3], None) == ""


def test_what_is_useful_is_stated():
    found = body({"m": 0.3, "I_xx": 0.003, "I_xy": 0.004, "c_y": 0.02})
    assert not any(too_wide(one, sizes(found, Useful()).get(one.name)) for one in found)
    asked = sizes(found, Useful(mass=0.1, moment=0.1, product=0.1, centre=0.05))
    assert {one.name for one in found if too_wide(one, asked.get(one.name))} == {
        "m_box",
        "I_xx_box",
        "I_xy_box",
        "c_y_box",
    }
