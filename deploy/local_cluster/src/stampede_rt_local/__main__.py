"""`python -m stampede_rt_local`: the same as `stampede dev`."""

import sys

from stampede_rt_local.dev import main

sys.exit(main())
