"""`python -m stampede_rt_frontend`."""

import gc
import signal
import sys

# until the service handles the signal itself: a signal during the imports ends the process without a traceback
signal.signal(signal.SIGINT, signal.SIG_DFL)
gc.disable()  # loading the modules makes no garbage, and the search for garbage would take a tenth of the time

import stampede_rt.grpc_quiet  # noqa: E402, F401  # before the service imports gRPC
from stampede_rt_frontend.app import main  # noqa: E402

gc.freeze()
gc.enable()
sys.exit(main())
