"""``python -m onboard.page LOG ADDRESS [SETTINGS]``, as ``heft fly --page`` starts it."""

import sys

from onboard.page.process import main

sys.exit(main(sys.argv[1:]))
