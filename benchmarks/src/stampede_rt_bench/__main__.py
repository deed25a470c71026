"""`python -m stampede_rt_bench NAME`: what `stampede bench NAME` does."""

import sys

from stampede_rt_bench.app import main

sys.exit(main())
