"""`python -m stampede_rt_bench NAME`, the same as `stampede bench NAME`."""

import sys

from stampede_rt_bench.app import main

sys.exit(main())
