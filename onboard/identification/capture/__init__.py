"""How a body moved before it was captured: on board once the payload is known, and in the fit of a whole flight."""
