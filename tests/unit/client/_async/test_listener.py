"""Any error that ends a listener is reported."""

from __future__ import annotations

import logging
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt._async.listener import Listener as AsyncListener
from stampede_rt._sync.listener import Listener


class Session:
    closed = False
    state = ""

    def attach(self, one: object) -> None: ...

    def detach(self, one: object) -> None: ...

    def check_process(self) -> None: ...


class Defective:
    """A subscription that fails with an unexpected error."""

    dropped = skipped = reconnects = 0

    def __enter__(self) -> Any:
        raise RuntimeError("nobody thought of it")

    def __exit__(self, *_: object) -> None: ...

    async def __aenter__(self) -> Any:
        raise RuntimeError("nobody thought of it")

    async def __aexit__(self, *_: object) -> None: ...

    def close(self) -> None: ...


def check(listener: Any, caplog: pytest.LogCaptureFixture) -> None:
    assert not listener.active
    assert isinstance(listener.error, st.StampedeError)
    assert str(listener.error) == "on_item of cam/left failed with a defect: RuntimeError: nobody thought of it"
    assert isinstance(listener.error.__cause__, RuntimeError)
    assert "Traceback" in caplog.text


def test_a_defect_ends_a_listener_with_its_error(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.ERROR):
        listener: Any = Listener(Session(), "cam/left", lambda _: Defective(), print)  # type: ignore[arg-type,return-value]
        assert listener.join(10)
    check(listener, caplog)


async def test_a_defect_ends_an_awaited_listener_with_its_error(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.ERROR):
        listener: Any = AsyncListener(Session(), "cam/left", lambda _: Defective(), print)  # type: ignore[arg-type,return-value]
        with pytest.raises(st.StampedeError, match="nobody thought of it"):
            await listener
        assert await listener.join(10)
    check(listener, caplog)
