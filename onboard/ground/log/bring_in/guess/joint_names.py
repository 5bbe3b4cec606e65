"""Columns that are called by their joints: ``elbow_pos`` and ``wrist_1_pos`` are angles of an arm.

So are ``elbow`` and ``wrist_deg`` of a vehicle whose joints are called so, or beside their torques.
"""

from collections.abc import Sequence

from onboard.ground.log.bring_in.guess.names import Name, kind_of, of_no_joint, quantity

_OF_JOINTS = ("angle", "rate", "acceleration", "torque", "current")
_BESIDE_ANGLES = ("torque", "current", "rate")
_UNITS_OF_ANGLES = ("", "rad", "deg")


def labelled(columns: Sequence[Name], vehicle: Sequence[str] = ()) -> list[Name]:
    """The same names, with the joint as label where two columns or more differ in nothing else.

    Without angles of the same joints nothing is a torque, a current or a rate of them: a supply has a current as well.

    Args:
        columns: names of all.
        vehicle: names of its joints' angles: columns that are called so, and of no quantity, are these.
    """
    alike: dict[tuple[tuple[str, ...], str], dict[int, str]] = {}
    for k, one in enumerate(columns):
        role = quantity(one.stem)
        joint = "_".join(word for word in one.stem if word not in role)
        if role and joint and not of_no_joint(joint) and (not one.label or one.label.isdigit()):
            alike.setdefault((role, one.unit), {})[k] = f"{joint}_{one.label}" if one.label else joint
    kinds = {place: kind_of(Name(place[0], "", place[1]), frozenset(some.values())) for place, some in alike.items()}
    result = list(columns)
    joints: set[str] = set()
    plain = {"_".join((*one.stem, one.label)).strip("_"): k for k, one in enumerate(columns) if not quantity(one.stem)}
    for place, some in alike.items():
        if kinds[place] in _BESIDE_ANGLES and len(some) > 1 and not joints and plain.keys() >= set(some.values()):
            joints = set(some.values())
            for joint in joints:
                result[plain[joint]] = Name(("angle",), joint, columns[plain[joint]].unit)
    for place, some in sorted(alike.items(), key=lambda item: kinds[item[0]] != "angle"):
        by_name = any(not columns[k].label for k in some) and len(set(some.values())) == len(some) > 1
        angle = kinds[place] == "angle" and place[1] in _UNITS_OF_ANGLES
        if not by_name or kinds[place] not in _OF_JOINTS or not (angle or joints >= set(some.values())):
            continue
        joints |= set(some.values()) if angle else set()
        for k, joint in some.items():
            result[k] = Name(place[0], joint, place[1])
    for k, joint in _plainly(columns, vehicle).items():
        result[k] = Name(("angle",), joint, columns[k].unit)
    return result


def _plainly(columns: Sequence[Name], vehicle: Sequence[str]) -> dict[int, str]:
    """Columns that are called like the joints of a vehicle, one for each and all in one unit."""
    for unit in _UNITS_OF_ANGLES:
        found = {
            _short("_".join((*one.stem, one.label)).strip("_")): k
            for k, one in enumerate(columns)
            if one.unit == unit and not quantity(one.stem)
        }
        own = {found[_short(joint)]: joint.lower() for joint in vehicle if _short(joint) in found}
        if own and len(own) == len(vehicle):
            return own
    return {}


def _short(joint: str) -> str:
    """``elbow`` of ``elbow_joint``, ``hinge1`` of ``hinge_1`` and of ``Hinge1``."""
    return joint.lower().removesuffix("_joint").removeprefix("joint_").replace("_", "")
