"""Units of forces and moments, and which others would make a tool of readings for which nobody named one.

Poses tell the centre of mass in moment units by force units, and nothing of the force's: without a name the mass is
that of an assumption, and so says the verdict.
"""

import re

from onboard.dynamics.model.inertia import sphere_radius_m

FORCE_UNITS = {
    **{"n": 1.0, "newton": 1.0, "kn": 1e3, "mn": 1e-3, "un": 1e-6},
    **{"kgf": 9.80665, "kp": 9.80665, "gf": 0.00980665, "lbf": 4.4482216},
}
MOMENT_UNITS = {
    **{"nm": 1.0, "nmm": 1e-3, "mnm": 1e-3, "ncm": 1e-2, "knm": 1e3, "kgfm": 9.80665},
    **{"kgfcm": 0.0980665, "lbfin": 0.11298483, "lbfft": 1.3558179, "ozfin": 0.0070615518, "unm": 1e-6},
}
# Of ROS (REP 103), of Franka's libfranka, of a UR's RTDE: N and N m, as their documents say
_SI = re.compile(r"wrench[^a-z]*(force|torque)|f_ext_hat|actual_tcp_force|ft_raw_wrench")
_PAIRS = (  # of a force and a moment, as sensors and people have them, the commonest first
    *(("N", "Nm"), ("N", "Nmm"), ("N", "Ncm"), ("kgf", "Nm"), ("kgf", "kgfcm"), ("kgf", "kgfm"), ("gf", "Nm")),
    *(("gf", "Nmm"), ("lbf", "lbfin"), ("lbf", "lbfft"), ("lbf", "Nm")),
)
_HELD = 10.0  # radii of a sphere of its mass, or a tenth of one: where the centre of a held tool is from the sensor


def are_si(name: str) -> bool:
    """Whether a column's name is one that a document defines in N and N m."""
    return bool(_SI.search(name.lower()))


def likelier(mass_kg: float, far_m: float, unnamed: tuple[str, ...]) -> str:
    """``in N and Nmm 1.76 kg at 81 mm``: units that make a held tool of what was read, the commonest three.

    Args:
        mass_kg: where forces without a unit are N.
        far_m: centre of mass from the sensor where moments without a unit are N m.
        unnamed: ``force``, ``moment``.

    Returns:
        Empty where N and N m make one, or none do.
    """
    found = []
    for force, moment in _PAIRS:
        if (force == "N" or "force" in unnamed) and (moment == "Nm" or "moment" in unnamed):
            factor = FORCE_UNITS[force.lower()]
            mass, far = mass_kg * factor, far_m * MOMENT_UNITS[moment.lower()] / factor
            if sphere_radius_m(mass) / _HELD < far < sphere_radius_m(mass) * _HELD:
                found.append(f"in {force} and {moment} {mass:.3g} kg at {_length(far)}")
                if (force, moment) == _PAIRS[0]:
                    return ""
    return ", ".join(found[:3])


def _length(value_m: float) -> str:
    return f"{value_m:.3g} m" if value_m >= 1.0 else f"{1e3 * value_m:.3g} mm"
