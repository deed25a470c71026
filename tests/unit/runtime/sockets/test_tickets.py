"""A ticket stands for the certificate that its caller has shown over gRPC."""

from __future__ import annotations

import pytest

from stampede_rt_runtime.sockets import tickets
from stampede_rt_runtime.sockets.tickets import SocketTickets

S = 10**9


def shown(number: int) -> dict[str, list[bytes]]:
    return {
        "x509_pem_cert": [b"certificate %d" % number],
        "peer_uri": [b"stampede://c/client/%d" % number],
        "transport_security_type": [b"ssl"],
    }


class Issuer:
    """Tickets of certificates that end `number` seconds after the beginning."""

    def __init__(self) -> None:
        self.now = 0
        self.tickets = SocketTickets(lambda pem: int(pem.split()[1]) * S, lambda: self.now)


def test_each_certificate_has_one_ticket_that_proves_it() -> None:
    one = Issuer().tickets
    first, second = one.issue(shown(1)), one.issue(shown(2))
    assert first
    assert second
    assert first != second
    assert one.issue(shown(1)) == first
    assert one.certificate_of(first) == {key: tuple(shown(1)[key]) for key in ("x509_pem_cert", "peer_uri")}


def test_a_connection_without_a_certificate_gets_an_empty_ticket_which_proves_nothing() -> None:
    one = Issuer().tickets
    assert one.issue({"transport_security_type": [b"insecure"]}) == b""
    assert one.certificate_of(b"") == one.certificate_of(b"made up") == {}


def test_a_ticket_of_another_process_proves_nothing() -> None:
    ticket = Issuer().tickets.issue(shown(1))
    assert ticket is not None
    assert Issuer().tickets.certificate_of(ticket) == {}


def test_new_certificates_above_the_limit_get_no_ticket_until_old_tickets_have_ended(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(tickets, "TICKETS_MAX", 3)
    one = Issuer()
    first, second, _ = (one.tickets.issue(shown(number)) for number in (1, 2, 9))
    assert one.tickets.issue(shown(4)) is None
    assert one.tickets.issue(shown(1)) == first
    one.now = 1 * S
    assert one.tickets.issue(shown(4))
    assert first is not None
    assert second is not None
    assert (one.tickets.certificate_of(first), bool(one.tickets.certificate_of(second))) == ({}, True)
