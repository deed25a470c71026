"""`python -m stampede_rt_demos NAME`: what `stampede demo NAME` does."""

import sys

from stampede_rt_demos.app import main

sys.exit(main())
