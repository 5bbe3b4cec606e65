"""Mechanics of a free-floating arm (Limparis section 2.1), for planning and analysis; ``heft mechanics`` shows them.

Everything is in the base's axes (SI units, float64) unless a name says otherwise. Generalized velocities are ordered
``[v_base (3), w_base (3), dq (n)]``, twists linear before angular. ``FloatingArm`` does the rigid-body arithmetic with
Pinocchio; the other modules stand on it or, where they are a second derivation of the same thing (virtual manipulator,
barycentric vectors, block system), on the geometry of the chain alone.
"""
