"""Tier T2: the twins behind real kernel interfaces, for unmodified programs.

``cuse`` is a character device served from Python, ``i2c_node`` makes it ``/dev/i2c-N``, ``socketcan`` puts the
simulated CAN bus on a network interface. Standard library only; nothing here reads a clock or starts a thread: the
caller passes the time and waits on ``files`` until ``due_ns``. Needs a kernel with CUSE and CAN and permission to use
them: ``deploy/kernel_bench.sh`` boots one.
"""
