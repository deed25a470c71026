"""`python -m stampede_rt_supernode`: the same as `stampede supernode`."""

import sys

from stampede_rt_supernode.app import main

sys.exit(main())
