"""`python -m stampede_rt_frontend`."""

import signal
import sys

signal.signal(signal.SIGINT, signal.SIG_DFL)  # until the service stops by itself: ended while it is loaded, and quietly

from stampede_rt_frontend.app import main  # noqa: E402

sys.exit(main())
