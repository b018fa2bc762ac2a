"""`python -m wlr_render` runs the command line."""

import sys

from wlr_render.cli import main

sys.exit(main())
