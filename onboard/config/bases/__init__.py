"""Tables of a vehicle file for the kinds of base that have one."""
