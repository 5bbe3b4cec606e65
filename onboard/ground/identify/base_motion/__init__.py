"""``heft predict``: motion of a floating base predicted from its joints, beside what its gyro measured."""
