"""A flight, or a log, on a page in any browser, served by this computer.

The page is a reader like any other: no worker of the flight waits for it. A viewer that is slow is left frames out,
which the page says; one that takes nothing is disconnected. Nothing can be done through the page but the ``acts`` that
the vehicle file arms, on the loopback interface.

``state`` makes frames of rows (plain numbers and texts), ``follow`` takes them from rings, ``recorded`` from a log;
``web`` speaks HTTP, ``address`` says who may ask, ``process`` is the process beside the flight.
"""
