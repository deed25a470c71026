"""`python -m stampede_rt_frontend`."""

import sys

from stampede_rt_frontend.app import main

sys.exit(main())
