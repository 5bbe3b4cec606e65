"""Register- and frame-accurate emulators of the devices, typed from their documents and sharing no table with a driver.

A twin is moved by ``advance(now_ns)`` or by the frames it gets, and never reads a clock. Behaviour that its document
leaves open is named in the module's docstring.
"""
