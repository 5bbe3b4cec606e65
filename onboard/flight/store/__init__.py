"""What a flight keeps: directories in shared memory, rings, manifest, log."""
