"""Truth: the bodies, moved by MuJoCo, and the motion that is prescribed to them."""
