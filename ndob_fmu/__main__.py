"""`python -m ndob_fmu`."""

import sys

from ndob_fmu.cli import main

sys.exit(main())
