"""`python -m stampede_rt.cli`, the same as the command `stampede`."""

import sys

from stampede_rt.cli.entry import main

sys.exit(main())
