"""`python -m stampede_rt_frontend`."""

import signal
import sys

signal.signal(signal.SIGINT, signal.SIG_DFL)  # until the service stops by itself: ended while it is loaded, and quietly

import stampede_rt.grpc_quiet  # noqa: E402, F401  # before the service imports gRPC
from stampede_rt_frontend.app import main  # noqa: E402

sys.exit(main())
