"""``heft hil VEHICLE --controller``: learning and computed torque on simulated drives."""
