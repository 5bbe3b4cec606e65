"""``python -m onboard.cli`` is ``heft``."""

import sys

from onboard.cli import main

sys.exit(main())
