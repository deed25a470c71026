"""The sockets to which the answer of a gatekeeper leads a client."""

from __future__ import annotations

import pytest

from stampede_rt.cluster.transport_choice import Transport
from stampede_rt.transports.socket_routes import TARGETS_MAX, SocketRoute
from stampede_rt.v1 import gatekeeper_service_pb2 as pb

OF_A_HOST = "unix:/run/user/1000/stampede/0123456789abcdef.sock"


def learned(*targets: str) -> tuple[str, ...]:
    route = SocketRoute("h1:7590", Transport.BEST)
    route.learn(pb.DataEndpoint(transport=pb.TRANSPORT_SOCKET, target=target) for target in targets)
    return route.targets


def test_the_path_of_a_host_is_used() -> None:
    assert learned(OF_A_HOST) == (OF_A_HOST,)


@pytest.mark.parametrize(
    "false",
    [
        "unix:/run/docker.sock",
        "unix:/run/user/1000/bus",
        "unix:\0abstract/0123456789abcdef.sock",
        "unix:/run/docker.sock\0/0123456789abcdef.sock",
        "unix:0123456789abcdef.sock",
        f"{OF_A_HOST}\n",
        "/run/0123456789abcdef.sock",
    ],
)
def test_a_false_host_leads_no_client_to_the_socket_of_another_program(false: str) -> None:
    assert learned(false, OF_A_HOST) == (OF_A_HOST,)


def test_a_client_tries_only_a_few_of_very_many_paths() -> None:
    assert learned(*(OF_A_HOST.replace("0123", f"{number:04x}") for number in range(1000))) == learned(
        *(OF_A_HOST.replace("0123", f"{number:04x}") for number in range(TARGETS_MAX))
    )


class WatchedRoute(SocketRoute):
    """Notes after each change the ticket that another thread would use to open a stream."""

    def __init__(self) -> None:
        self.led_with: list[bytes] = []
        super().__init__("h1:7590", Transport.BEST)

    def __setattr__(self, name: str, value: object) -> None:
        super().__setattr__(name, value)
        if vars(self).get("_targets"):
            self.led_with.append(self.ticket)


def test_no_thread_finds_the_sockets_before_the_ticket_that_belongs_to_them() -> None:
    route = WatchedRoute()
    route.learn([pb.DataEndpoint(transport=pb.TRANSPORT_SOCKET, target=OF_A_HOST, ticket=b"new")])
    assert set(route.led_with) == {b"new"}
