"""`python -m stampede_rt_frontend`."""

import gc
import signal
import sys

# until the service handles the signal itself: a signal during the imports ends the process without a traceback
signal.signal(signal.SIGINT, signal.SIG_DFL)
gc.disable()  # the loading of the modules makes no garbage, and a tenth of its time would go into the search for some

import stampede_rt.grpc_quiet  # noqa: E402, F401  # before the service imports gRPC
from stampede_rt_frontend.app import main  # noqa: E402

gc.freeze()
gc.enable()
sys.exit(main())
