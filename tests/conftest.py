"""Settings and fixtures for all tests."""

from __future__ import annotations

import gc
import os
import signal
import sys
import tempfile
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from xdist.remote import Producer
from xdist.scheduler import LoadFileScheduling

from stampede_rt_local.process import ServiceProcess
from tests.support.forking.forked_popen import ForkedPopen
from tests.support.sharing.shares import at_end_of_share, share_of

# Each run of the suite plays the same scenarios. So a new failure comes from a change of the code, and not from other
# random choices. `make explore` plays other scenarios.
settings.register_profile("suite", derandomize=True, database=None, deadline=None)
settings.register_profile("explore", database=None, deadline=None, print_blob=True)
settings.load_profile("suite")

# A job that a shell started in the background ignores Ctrl-C, and so do all its children. Tests that interrupt a child
# would then wait for ever. With a handler of its own here, the children of this process begin with the default handler
# again.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Files that start processes come first. If such a file began last, it would still run while the other workers are idle.
FIRST_OF_ALL = (
    "polyglot",
    "robustness",
    "integration",
    "unit/supernode/joining",
    "unit/supernode/test_app_processes.py",
    "unit/benchmarks",
    "property",
    "contract",
)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, None, None]:
    """Collect the tests while the garbage collector is off, and keep the collected tests out of its later searches.

    Each worker collects all tests. If the garbage collector were on, a quarter of the time would go into its searches
    through objects that stay alive.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of FIRST_OF_ALL first, in its order. The rest stays as it is.

    If STAMPEDE_TEST_ACL is set (`make test-acl`), rules of access restrict the client of the tests. Some tests cannot
    run in this way. They have a mark with the reason, @pytest.mark.without_rules("its services know no rules"), and are
    skipped.
    """
    if os.environ.get("STAMPEDE_TEST_ACL"):
        for item in items:
            for marker in item.iter_markers("without_rules"):
                item.add_marker(pytest.mark.skip(reason=marker.args[0]))

    def place(item: pytest.Item) -> int:
        path = item.path.relative_to(Path(__file__).parent).as_posix()
        return next((at for at, first in enumerate(FIRST_OF_ALL) if path.startswith(first)), len(FIRST_OF_ALL))

    items.sort(key=place)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> LoadFileScheduling | None:
    """With `--dist loadfile`, give all files of a share to the same worker."""
    return SharesScheduling(config, log) if config.getvalue("dist") == "loadfile" else None


class SharesScheduling(LoadFileScheduling):
    """Gives each worker one share of the files after another. Most shares are one file."""

    def _split_scope(self, nodeid: str) -> str:
        return share_of(nodeid)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None, None, None]:
    """End the things that the files of a share have used, after its last test."""
    try:
        yield
    finally:
        if nextitem is None or share_of(nextitem.nodeid) != share_of(item.nodeid):
            at_end_of_share.close()


@pytest.fixture(scope="session", autouse=True)
def _end_of_last_share() -> Iterator[None]:
    """End the things of a share even if the run stops before its last test."""
    yield
    at_end_of_share.close()


# Clients and services read a secret from the user's folder of settings, and `stampede dev` writes one there. The suite
# uses an empty folder of its own. So it neither reads nor changes the secret of the user who runs it. pytest-xdist
# sets COLUMNS for its workers. The suite removes it, because the tested commands would take it for their terminal's
# width.
_settings_folder = tempfile.TemporaryDirectory(prefix="stampede-tests-")
os.environ["XDG_CONFIG_HOME"] = _settings_folder.name
for variable in ("STAMPEDE_SECRET_FILE", "STAMPEDE_URL", "COLUMNS", "LINES"):
    os.environ.pop(variable, None)

# The suite starts hundreds of Python processes. Where bytecode files are forbidden (as in many container images)
# each of them would compile all its modules again, which takes half of its CPU time. So they keep bytecode in `.make`.
# The processes of pytest keep theirs there, too, because the tests are many modules.
if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):
    sys.dont_write_bytecode = False
    sys.pycache_prefix = os.environ["PYTHONPYCACHEPREFIX"] = str(Path(__file__).parents[1] / ".make" / "pycache")

# The services that tests start themselves need not load their modules again and again.
ServiceProcess.popen_class = ForkedPopen
