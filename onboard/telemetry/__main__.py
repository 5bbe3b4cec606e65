"""``python -m onboard.telemetry LOG LINK SETTINGS``, as ``heft fly --telemetry`` starts it."""

import sys

from onboard.telemetry.process import main

sys.exit(main(sys.argv[1:]))
