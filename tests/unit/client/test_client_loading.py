"""`import stampede_rt` and the start of the command load few modules. When gRPC is loaded, it logs only errors."""

from __future__ import annotations

import subprocess
import sys
from importlib.machinery import ModuleSpec
from importlib.util import find_spec

import pytest

from stampede_rt.cli.main import main

SECONDS_MAX = 60
# Reports when Python looks for one of these modules, with the level at which gRPC would log if it were loaded then.
WATCH = """
import os, sys
class Watch:
    def find_spec(self, name, path=None, target=None):
        if name in ("grpc", "google.protobuf", "argparse"):
            print(name, os.environ.get("GRPC_VERBOSITY"))
sys.meta_path.insert(0, Watch())
"""


def output_of(code: str) -> str:
    command = [sys.executable, "-c", WATCH + code]
    done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS_MAX, check=True)
    return done.stdout


@pytest.mark.parametrize(
    "module", ["stampede_rt", "stampede_rt.cli.main", "stampede_rt.values.timeline", "stampede_rt.errors"]
)
def test_modules_that_need_no_connection_do_not_load_grpc(module: str) -> None:
    assert output_of(f"import {module}") == ""


def test_the_public_names_are_loaded_on_first_use() -> None:
    code = """
import stampede_rt as st
print("connect" in dir(st), "Mailbox" in st.__all__)
from stampede_rt import *
print(connect is st.connect, st.errors.TooOld is TooOld, hasattr(st, "nothing"), hasattr(st, "surface"))
"""
    output = output_of(code)
    assert output.splitlines()[-2:] == ["True True", "True True False True"], output


def test_the_asyncio_client_does_not_load_the_blocking_one() -> None:
    output = output_of(
        "from stampede_rt import aio; print([name for name in sys.modules if 'stampede_rt._sync' in name])"
    )
    assert output.splitlines()[-1] == "[]", output


@pytest.mark.parametrize(
    "code",
    [
        "import stampede_rt; stampede_rt.connect",
        "import stampede_rt.aio",
        "import stampede_rt.status",
        "import stampede_rt.transports.stubs",
        "import stampede_rt._sync.endpoints",
        "from stampede_rt.cli.main import main; main(['ls', '--url', 'localhost:x'])",
        *(
            f"import runpy; sys.argv = ['x', '--help']; runpy.run_module('stampede_rt_{service}', run_name='__main__')"
            for service in ("frontend", "supernode", "channel_host")
        ),
    ],
)
def test_grpc_is_loaded_so_that_it_logs_errors_only(code: str) -> None:
    output = output_of(f"try:\n    {code}\nexcept SystemExit:\n    pass")
    assert "grpc ERROR" in output.splitlines(), output


class Interrupted:
    """Raises the error of Ctrl-C when Python looks for a module."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if name == "stampede_rt.cli.commands":
            raise KeyboardInterrupt
        return None


def test_an_interrupt_while_the_command_loads_ends_it_without_a_message(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert find_spec("stampede_rt.cli.commands") is not None
    monkeypatch.delitem(sys.modules, "stampede_rt.cli.commands", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Interrupted(), *sys.meta_path])
    assert main(["ls"]) == 130
    assert capsys.readouterr() == ("", "")


def test_a_client_without_cryptography_says_which_extra_multicast_needs() -> None:
    without = """
import sys
sys.modules["cryptography"] = None
from stampede_rt._sync.subscription_kinds import kind_of_subscription
from stampede_rt.errors import InvalidArgument
kind_of_subscription(None)
try:
    kind_of_subscription("multicast")
except InvalidArgument as error:
    print("told:", error)
"""
    assert "pip install 'stampede-rt[multicast]'" in output_of(without).partition("told:")[2]
