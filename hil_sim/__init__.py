"""The world outside the flight computer: bodies moved by MuJoCo, sensors, and emulators of the devices on the buses.

Rule of the room: nothing here is shared with ``drivers`` or ``onboard`` except ``drivers.ports``. Geometry, register
maps and frames are typed from the tables and datasheets a second time, so that a mistake on one side cannot cancel
itself.
"""

import os

os.environ.setdefault("MUJOCO_GL", "disable")  # nothing is drawn: GLFW takes 0.05 s of every start
