"""The compiled core: arithmetic on small arrays, in C11, that makes the same bits on every computer.

``src`` has the sources, ``build`` compiles them, ``library`` finds or makes the library and calls it. Loops stand in a
fixed order, multiplications and additions are not fused, sine, cosine and exponential are compiled in: what it computes
depends on no processor, compiler or mathematics library. Arrays are the caller's; their shapes are checked before each
call. Plain NumPy of the same equations is in ``tests/native``, which the library is tested against; there is none to
fall back to.
"""
