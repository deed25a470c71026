"""`python -m stampede_rt_demos NAME`, the same as `stampede demo NAME`."""

import sys

from stampede_rt_demos.app import main

sys.exit(main())
