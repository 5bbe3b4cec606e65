"""``python -m onboard.live LOG HOST:PORT``, as ``heft fly --live`` starts it."""

import sys

import foxglove

from onboard.live.process import main

foxglove.set_log_level("CRITICAL")  # else one line of text per message dropped for a stalled client
sys.exit(main(sys.argv[1:]))
