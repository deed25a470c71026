"""`python -m stampede_rt_channel_host`."""

import sys

from stampede_rt_channel_host.app import main

sys.exit(main())
