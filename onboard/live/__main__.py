"""``python -m onboard.live LOG HOST:PORT``, as ``heft fly --live`` starts it."""

import sys

import foxglove

from onboard.live.process import main

foxglove.set_log_level("CRITICAL")  # or a line of text for every message that a stalled client does not take
sys.exit(main(sys.argv[1:]))
