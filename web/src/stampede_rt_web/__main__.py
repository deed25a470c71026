"""`python -m stampede_rt_web`."""

import signal
import sys

# Ctrl-C during the imports ends the process without a traceback. Later the service handles the signal itself.
signal.signal(signal.SIGINT, signal.SIG_DFL)

import stampede_rt.grpc_quiet  # noqa: E402, F401  # before the service imports gRPC
from stampede_rt_web.app import main  # noqa: E402

sys.exit(main())
