"""One module per kind of device: its table in vehicle.toml, channels, driver, clock, delays, role, checks.

``registry`` finds them; ``base``, ``buses``, ``canopen`` and ``roles`` have the common parts. A kind from another
package is found by its entry point in group ``heft.devices``. Known limit: importing a kind imports its driver.
"""
