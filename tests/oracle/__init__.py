"""The time model, written down a second time: small, slow, and right on sight.

Everything is found by looking at every item. There is no index, no running total that a definition does not name, and
no shortcut; sets of instants are compared as sets over continuous time. Paths through the real store, over whatever
transport, are tested against it.
"""

from tests.oracle.channel import Item, OracleChannel, Refused, Waits
from tests.oracle.consumers import OracleConsumers
from tests.oracle.reading import OracleAnswer, OracleGet, OracleReader
from tests.oracle.runs import Ack, OracleRetries, put_run
from tests.oracle.subscription import OracleNewest, OracleSubscription

__all__ = [
    "Ack",
    "Item",
    "OracleAnswer",
    "OracleChannel",
    "OracleConsumers",
    "OracleGet",
    "OracleNewest",
    "OracleReader",
    "OracleRetries",
    "OracleSubscription",
    "Refused",
    "Waits",
    "put_run",
]
