"""Rigid-body model of the vehicle: URDF, inertial parameters, kinematics, motion of free and air-bearing bases.

SI units, float64; every frame and axis is named. Gravity is zero and the base's measured specific force takes its
place, so that the attitude is not needed. Imports ``onboard.estimation`` only.
"""
