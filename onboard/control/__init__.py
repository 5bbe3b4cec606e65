"""Control of an arm by joint torques (Limparis section 2.2.1): learning over trials, and computed torque.

Numbers in, numbers out: what is sent to drives and when is ``onboard.flight.trials``. All arrays are float64, SI units;
n joints, m SYNCs of a trial. ``motion`` is what is tracked, ``drives`` what a joint's drive adds to the arm, ``laws``
the torques of one SYNC, ``learning`` what one trial changes for the next, ``watch`` when to stop.
"""
