"""Motion played to the drives of a CANopen bus on its SYNC."""
