"""``python -m goldfield``."""

import sys

from goldfield.cli import main

sys.exit(main())
