"""python3 -m dolfinx_signorini is the command line."""

import sys

from dolfinx_signorini.commands.main import main

sys.exit(main())
