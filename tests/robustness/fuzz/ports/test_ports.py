"""A short run of the ports' part of `make fuzz`: all RPCs of a real host, supernode and front-end."""

from __future__ import annotations

import pytest

from tests.robustness.fuzz.ports.methods import PORTS
from tests.robustness.fuzz.ports.run import run

INPUTS = {"host": 4000, "data": 2000, "supernode": 2000, "frontend": 1000}
# In this test, callers of these ports bring certificates, and callers of the other ports bring the secret.
WITH_CERTIFICATES = ("data", "frontend")


@pytest.mark.parametrize("port", PORTS)
async def test_no_call_of_any_kind_breaks_a_port(port: str) -> None:
    outcome = await run(port, seed=11, inputs=INPUTS[port], tls=port in WITH_CERTIFICATES, commands=False)
    print(outcome)
    assert outcome.findings == []
    assert outcome.good_failures == []
    assert outcome.inputs >= INPUTS[port]
