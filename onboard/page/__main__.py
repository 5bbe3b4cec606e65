"""``python -m onboard.page LOG ADDRESS``, as ``heft fly --page`` starts it."""

import sys

from onboard.page.process import main

sys.exit(main(sys.argv[1:]))
