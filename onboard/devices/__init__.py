"""One module for each kind of device: its table in vehicle.toml, channels, driver, clock, delays, role, own checks.

``registry`` finds them; ``base``, ``buses``, ``canopen`` and ``roles`` have what kinds share. A kind from another
package is found by its entry point in group ``heft.devices``. Known wart: importing a kind imports its driver.
"""
