"""`python -m stampede_rt_channel_host`."""

import signal
import sys

signal.signal(signal.SIGINT, signal.SIG_DFL)  # until the service stops by itself: ended while it is loaded, and quietly

from stampede_rt_channel_host.app import main  # noqa: E402

sys.exit(main())
