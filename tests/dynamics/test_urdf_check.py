"""What cannot fly is refused with line, name and remedy; what passes can be a model, and can be moved by MuJoCo."""

from pathlib import Path

import pytest

from onboard.dynamics.model.bases import BaseKind
from onboard.dynamics.model.urdf_check import require_flyable
from onboard.dynamics.model.urdf_reading import DrawingError, plain
from onboard.dynamics.model.vehicle import VehicleModel, VehicleSpec

BASE = '<inertial><mass value="10"/><inertia ixx="0.2" iyy="0.2" izz="0.2" ixy="0" ixz="0" iyz="0"/></inertial>'
ARM = '<inertial><mass value="1"/><inertia ixx="1e-3" iyy="5e-3" izz="5e-3" ixy="0" ixz="0" iyz="0"/></inertial>'
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
WHEEL = """<link name="wheel"/>
<joint name="wheel" type="continuous"><parent link="base"/><child link="wheel"/></joint>"""


def urdf(base: str = BASE, arm: str = ARM, joint: str = LIMIT, more: str = "", kind: str = "revolute") -> str:
    """Lines 2 and 3: the links; line 4: the joint; from line 6 on: more."""
    return f"""<robot name="air_bearing_arm">
<link name="base">{base}</link>
<link name="arm">{arm}</link>
<joint name="shoulder" type="{kind}"><origin xyz="0.2 0 0"/><parent link="base"/><child link="arm"/>{joint}</joint>

{more}
</robot>"""


def arm_of(**changed: str) -> str:
    text = ARM
    for key, value in changed.items():
        before = text.split(f'{key}="')[1].split('"')[0]
        text = text.replace(f'{key}="{before}"', f'{key}="{value}"')
    return text


def origin(xyz: str = "0 0 0", rpy: str = "0 0 0") -> str:
    return f'<origin xyz="{xyz}" rpy="{rpy}"/>'


FORM = [
    ("", 1, "no XML: it ends before"),
    ("\n\n <?xml version='1.0'?><robot/>", 3, r"no XML: something stands before <\?xml"),
    ("<robot>\n<a:b/></robot>", 2, "no XML: a tag's prefix is declared nowhere"),
    ("<robot>\n<link></robot>", 2, "no XML: a tag is closed that is not open"),
    ("<sdf/>", 1, "no URDF: its first tag is <sdf>"),
    (
        '<robot\nxmlns="http://www.ros.org"/>',
        1,
        "its tags are in the namespace 'http://www.ros.org'.* take xmlns=\"...\" out of <robot>",
    ),
    ("<robot/>", 1, "it has no <link>"),
    (
        '<robot xmlns:xacro="http://ros.org/wiki/xacro">\n<xacro:arm/></robot>',
        2,
        r"written for xacro \(<xacro:arm>\); write it out first",
    ),
    (urdf(more='<link name="arm"/>'), 6, "link 'arm' stands in line 3 too; rename"),
    (urdf(more="<link/>"), 6, "<link name=None>: give it a name"),
    (urdf(more='<link name="a&#10;b"/>'), 6, "give it a name of letters"),
    (
        urdf(
            more='<link name="c"/>\n<joint name="shoulder" type="fixed"><parent link="arm"/><child link="c"/></joint>'
        ),
        7,
        "joint 'shoulder' stands in line 4 too; rename",
    ),
    (urdf(joint=LIMIT + "\n" + LIMIT), 5, "<joint> has <limit> a second time; take either out"),
    (urdf(arm=ARM + "\n" + ARM), 4, "<link> has <inertial> a second time"),
    (urdf(kind="floating"), 4, "joint 'shoulder' is 'floating'; .* base = \"free\" lets the root go"),
    (urdf(kind="hinge"), 4, "joint 'shoulder' is 'hinge'; fixed, revolute"),
    (urdf().replace('<child link="arm"/>', ""), 4, "lacks <child"),
    (urdf().replace('<child link="arm"/>', '<child link="amr"/>'), 4, "names link 'amr', .* did you mean 'arm'"),
    (urdf(more='<link name="c"/>'), 6, "it hangs on base, c; a vehicle has a single root"),
    (
        urdf(more='<joint name="j" type="fixed"><parent link="arm"/><child link="base"/></joint>'),
        2,
        "hangs on nothing, for its joints go in a ring",
    ),
    (
        urdf(more='<joint name="j" type="fixed"><parent link="base"/><child link="arm"/></joint>'),
        6,
        "link 'arm' hangs on joint 'j' and on 'shoulder'",
    ),
    (
        urdf(
            more='<link name="c"/><link name="d"/>\n<joint name="j" type="fixed"><parent link="c"/><child link="d"/>'
            '</joint><joint name="k" type="fixed"><parent link="d"/><child link="c"/></joint>'
        ),
        6,
        "link 'c' is in a ring of joints",
    ),
    (urdf(arm='<inertial><mass value="1"/></inertial>'), 3, "link 'arm': <inertial> has no <inertia>"),
]
NUMBERS = [
    (urdf(arm=arm_of(value="0_1")), 3, "link 'arm': mass: value='0_1' is no number"),
    (urdf(arm=arm_of(value="1,5")), 3, "value='1,5' is no number; write it in digits with a decimal point"),
    (urdf(arm=arm_of(value="nan")), 3, "value='nan' is no number"),
    (urdf(arm=arm_of(value="1e999")), 3, "value='1e999' is no number"),
    (urdf(arm=arm_of(value="١")), 3, "is no number"),
    (urdf(arm=arm_of(value="1e9")), 3, "1e9 kg is more than anything that flies has"),
    (urdf(arm=arm_of(value="-1")), 3, "weighs -1 kg; a mass is zero or more"),
    (urdf(arm=ARM.replace(' ixy="0"', "")), 3, "link 'arm': inertia has no ixy"),
    (urdf(joint=LIMIT + "<axis xyz='0 0 0'/>"), 4, "joint 'shoulder' has an axis of no length"),
    (urdf(joint=LIMIT + "<axis xyz='0 1'/>"), 4, "joint 'shoulder': axis: xyz='0 1' is not three numbers"),
    (urdf().replace("0.2 0 0", "1e200 0 0"), 4, "joint 'shoulder': origin: xyz: 1e200 m is more than .* in metres"),
    (urdf().replace("0.2 0 0", "0 300 0"), 4, "origin: xyz: 300 m is more than .*: 300 mm are 0.3"),
    (urdf().replace('"0.2 0 0"', '"0.2 0 0" rpy="0 90 0"'), 4, "rpy: 90 rad is more than .* 90 degrees are 1.5708"),
    (urdf(joint=LIMIT.replace('upper="1"', 'upper="fast"')), 4, "joint 'shoulder': limit: upper='fast' is no number"),
]
BODIES = [
    (urdf(joint=LIMIT.replace("-1", "2")), 4, "joint 'shoulder' goes from 2 to 1; write lower below upper"),
    (urdf(joint="<limit effort='1' velocity='1'/>"), 4, "joint 'shoulder' goes from 0 to 0"),
    (urdf(joint=""), 4, "joint 'shoulder' has no <limit>; add it with lower and upper"),
    (urdf(joint=LIMIT + "<mimic joint='other'/>"), 4, "joint 'shoulder' follows 'other', which is not simulated"),
    (urdf(arm=""), 3, "link 'arm', which joint 'shoulder' moves, has no mass or no inertia"),
    (urdf(arm=arm_of(ixx="0", iyy="0", izz="0")), 3, "link 'arm', which joint 'shoulder' moves"),
    (urdf(more=WHEEL), 6, "link 'wheel', which joint 'wheel' moves, has no mass or no inertia, .*give it <inertial>"),
    (urdf(arm=arm_of(value="0")), 3, "link 'arm' has an inertia and no mass"),
    (urdf(arm=arm_of(izz="7e-3")), 3, "'arm' has the principal moments of inertia 0.001, 0.005 and 0.007 kg m2; none"),
    (urdf(arm=arm_of(ixx="5.00e-3", izz="1.01e-2")), 3, "if they are rounded, lower the largest by more than 0.0001"),
    (urdf(arm=arm_of(ixx="-1e-3")), 3, "each has to be more than zero"),
    (urdf(arm=arm_of(ixy="4e-3")), 3, "each has to be more than zero: correct them, or their products"),
    (urdf(arm=arm_of(value="1e-6", ixx="5", iyy="5", izz="5")), 3, "2236 m from its centre"),
    (
        urdf(
            arm='<inertial><mass value="0.080"/><inertia ixx="0.097" iyy="0.07" izz="0.08" ixy="0" ixz="0" iyz="0"/>'
            '</inertial><visual><geometry><box size="0.13 0.02 0.02"/></geometry></visual>'
        ),
        3,
        "link 'arm' weighs 0.08 kg and has 0.097 kg m2: all its mass would be 1.1 m from its centre, and its shape is",
    ),
    (urdf(base=""), 2, "the base, link 'base' with what is fixed to it, weighs nothing; a link that is free"),
]


@pytest.mark.parametrize(("text", "line", "says"), FORM + NUMBERS + BODIES)
def test_what_cannot_fly_is_refused_by_line_name_and_remedy(text: str, line: int, says: str) -> None:
    with pytest.raises(DrawingError, match=says) as raised:
        require_flyable(text, BaseKind.FREE, label="arm.urdf")
    assert [problem.line for problem in raised.value.problems] == [line]
    assert str(raised.value).startswith(f"arm.urdf:{line}: ")
    with pytest.raises(DrawingError, match=says):
        VehicleModel(text, VehicleSpec(BaseKind.FREE, "base"))


def test_all_that_is_wrong_is_told_at_once_and_not_more_than_helps() -> None:
    wrong = "".join(f'<link name="l{n}"><inertial><mass value="?"/></inertial></link>\n' for n in range(20))
    with pytest.raises(DrawingError) as raised:
        require_flyable(urdf(more=wrong), BaseKind.FREE)
    assert len(raised.value.problems) == 20
    assert str(raised.value).splitlines()[-1] == "the URDF: and 12 more like these"


@pytest.mark.parametrize(
    "text",
    [
        urdf(),
        urdf(arm=arm_of(ixx="0")),  # a rod without thickness
        urdf(arm=arm_of(ixx="4e-3", iyy="4e-3", izz="8e-3")),  # a plate without thickness
        urdf(kind="continuous", joint=""),
        urdf(more=WHEEL.replace('<link name="wheel"/>', f'<link name="wheel">{ARM}</link>')),  # names of both
        urdf(joint=LIMIT + "<mimic joint='other'/>", kind="fixed"),
        urdf(base=BASE + "<visual><geometry><box size='a b c'/></geometry></visual>"),  # a picture is not read
        urdf(joint=LIMIT + "<dynamics damping='?'/><safety_controller/>").replace("<robot ", "<robot version='9' "),
        urdf().replace('"arm"', '"Bras [é] (1) 腕"'),
    ],
)
def test_what_can_fly_is_a_model(text: str) -> None:
    drawing = require_flyable(text, BaseKind.FREE)
    model = VehicleModel(text, VehicleSpec(BaseKind.FREE, "base"))
    assert set(model.links) <= set(drawing.links)
    assert [joint.name for joint in model.joints] == [one.name for one in drawing.joints.values() if one.moves]
    assert plain(require_flyable(plain(drawing), BaseKind.FREE)) == plain(drawing)


REST = LIMIT.replace('lower="-1" upper="1"', "")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (urdf(arm=""), "moves, has no mass or no inertia"),  # Staubli TX40's last link
        (urdf(joint=REST), "goes from 0 to 0"),
        (urdf(arm=arm_of(value="0")), "has an inertia and no mass"),  # Panda's flange
        (urdf(joint=LIMIT + "<origin/>"), "<joint> has <origin> a second time"),  # KUKA LWR 4
    ],
)
def test_a_recorded_arm_needs_no_more_than_its_axes_and_one_that_may_be_simulated_does(text: str, says: str) -> None:
    require_flyable(text, BaseKind.FIXED)
    VehicleModel(text, VehicleSpec(BaseKind.FIXED, "base"))
    with pytest.raises(DrawingError, match=says):
        require_flyable(text, BaseKind.FIXED, simulated=True)


@pytest.mark.timeout(60)  # a second or two; minutes where the time grows with the square of the joints
def test_chains_that_nothing_can_hold_are_refused_at_once() -> None:
    for kind, count in (("revolute", 1000), ("fixed", 20_000)):
        links = "".join(f'<link name="l{n}">{ARM}</link>' for n in range(count + 1))
        joints = "".join(
            f'<joint name="j{n}" type="{kind}"><parent link="l{n}"/><child link="l{n + 1}"/>{LIMIT}</joint>'
            for n in range(count)
        )
        with pytest.raises(DrawingError, match="joints that move; 2000 and 127 are the most"):
            require_flyable(f"<robot>{links}{joints}</robot>", BaseKind.FIXED)


def test_packaged_vehicles_pass() -> None:
    vehicles = Path(__file__).parents[2] / "onboard" / "vehicles"
    found = sorted(vehicles.glob("*/*.urdf"))
    assert len(found) >= 8
    for path in found:
        require_flyable(path.read_text(encoding="utf-8"), BaseKind.FIXED, label=str(path), simulated=True)
