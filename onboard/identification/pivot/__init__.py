"""A body on a spherical air bearing: fit of its inertia and of the offset of its centre of mass."""
