"""What inertial chips with a FIFO share: packets to rows, draining, numbers of samples; no register of any of them."""
