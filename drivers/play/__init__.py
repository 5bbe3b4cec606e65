"""Motion played to the drives of a bus, whatever their kind: the master, its player, and what a drive has to do."""
