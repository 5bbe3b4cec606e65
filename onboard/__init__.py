"""Flight computer side of heft: records, vehicle time, measurement rows, estimation, log, and tools on the ground."""
