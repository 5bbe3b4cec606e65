"""Derivatives of a predicted base's motion, from what is kept of it."""

FIELDS = ("rate", "acceleration", "specific_force")


def derivative(base, field):
    """Of one of ``FIELDS``, (n, 3, 3 + c)."""
    if field == "rate":
        return base.d_rate
    rows = {"specific_force": slice(0, 3), "acceleration": slice(3, 6)}[field]
    return base.by_rate[:, rows] @ base.along[:, :3] + base.by_wrench[:, rows] @ base.along[:, 3:]
