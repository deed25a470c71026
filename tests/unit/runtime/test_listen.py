"""The addresses at which a service may listen."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from stampede_rt_runtime.listen import AddressNotAllowed, CannotListen, check_listen


@pytest.fixture
def taken_port() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as holder:
        yield holder.getsockname()[1]


@pytest.mark.parametrize("listen", ["localhost:0", "127.0.0.1:0", "127.0.0.9:0"])
def test_loopback_is_always_allowed(listen: str) -> None:
    assert str(check_listen(listen, allow_insecure_anywhere=False)) == listen


@pytest.mark.parametrize("listen", ["0.0.0.0:0", "[::]:0", "192.0.2.1:0"])
def test_an_address_beyond_loopback_is_refused_and_the_error_names_the_flag(listen: str) -> None:
    with pytest.raises(AddressNotAllowed, match="add --allow-insecure-anywhere"):
        check_listen(listen, allow_insecure_anywhere=False)


def test_the_flag_allows_an_address_beyond_loopback() -> None:
    assert check_listen("0.0.0.0:0", allow_insecure_anywhere=True).host == "0.0.0.0"


def test_a_port_in_use_is_refused_with_its_address(taken_port: int) -> None:
    with pytest.raises(CannotListen, match=f"localhost:{taken_port} is in use by another process"):
        check_listen(f"localhost:{taken_port}", allow_insecure_anywhere=False)


def test_a_port_in_use_at_the_wildcard_address_is_noticed(taken_port: int) -> None:
    with pytest.raises(CannotListen, match="is in use"):
        check_listen(f"0.0.0.0:{taken_port}", allow_insecure_anywhere=True)


def test_a_port_whose_last_user_has_just_closed_is_free() -> None:
    with socket.create_server(("127.0.0.1", 0)) as holder:
        address = holder.getsockname()
        with socket.create_connection(address) as caller:
            accepted, _ = holder.accept()
            accepted.close()  # the listening side closes first: its port lingers in TIME_WAIT
            assert caller.recv(1) == b""
    check_listen(f"127.0.0.1:{address[1]}", allow_insecure_anywhere=False)


def test_an_address_of_another_machine_is_refused() -> None:
    with pytest.raises(CannotListen, match=r"192\.0\.2\.1 is not an address of this machine"):
        check_listen("192.0.2.1:0", allow_insecure_anywhere=True)


def test_a_name_that_does_not_resolve_is_refused() -> None:
    with pytest.raises(CannotListen, match=r"'no-such-host\.invalid' is not a name or address"):
        check_listen("no-such-host.invalid:0", allow_insecure_anywhere=True)
