"""Parts of a URDF that ``heft init`` sketches."""


def link(name: str, mass_kg: float, centre_m: tuple[float, float, float], length_m: float) -> str:
    """A slender link along x, or the base, a ball."""
    slender, round_ = mass_kg * length_m**2 / 12.0, mass_kg * 0.05**2 / 2.0
    centre = " ".join(f"{part:g}" for part in centre_m)
    inertia = (round_, slender, slender) if name != "base" else (slender, slender, slender)
    ixx, iyy, izz = (f"{part:.5g}" for part in inertia)
    return f"""  <link name="{name}">
    <inertial>                                            <!-- yours -->
      <origin xyz="{centre}" rpy="0 0 0"/>
      <mass value="{mass_kg:g}"/>
      <inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
"""


def mount(name: str, parent: str, place: str, turned: str = "0 0 0", note: str = "") -> str:
    """A frame of the URDF, fixed to a link."""
    return f"""  <link name="{name}"/>
  <joint name="{name}_mount" type="fixed">
    <parent link="{parent}"/>
    <child link="{name}"/>
    <origin xyz="{place}" rpy="{turned}"/>{note}
  </joint>
"""
