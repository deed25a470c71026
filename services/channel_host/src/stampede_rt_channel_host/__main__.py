"""`python -m stampede_rt_channel_host`."""

import gc
import signal
import sys

# Ctrl-C during the imports ends the process without a traceback. Later the service handles the signal itself.
signal.signal(signal.SIGINT, signal.SIG_DFL)
# The loading of the modules makes no garbage. The search for garbage would take a tenth of the loading time.
gc.disable()

from stampede_rt_runtime.memory.huge_pages import start_again_with_huge_pages  # noqa: E402

start_again_with_huge_pages("stampede_rt_channel_host", sys.argv[1:])

import stampede_rt.grpc_quiet  # noqa: E402, F401  # before the service imports gRPC
from stampede_rt_channel_host.app import main  # noqa: E402

gc.freeze()
gc.enable()
sys.exit(main())
