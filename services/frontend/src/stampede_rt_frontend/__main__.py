"""`python -m stampede_rt_frontend`."""

import gc
import signal
import sys

# Ctrl-C during the imports ends the process without a traceback. Later the service handles the signal itself.
signal.signal(signal.SIGINT, signal.SIG_DFL)
# The loading of the modules makes no garbage. The search for garbage would take a tenth of the loading time.
gc.disable()

import stampede_rt.grpc_quiet  # noqa: E402, F401  # before the service imports gRPC
from stampede_rt_frontend.app import main  # noqa: E402

gc.freeze()
gc.enable()
sys.exit(main())
