"""The model of a vehicle: URDF, links, inertia, payload."""
