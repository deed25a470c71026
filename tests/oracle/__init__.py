"""The oracle: the rules of the time model in a second implementation, which is simple, slow and easy to check.

The oracle looks at every item for every answer. It has no index, and keeps only the sums that a rule names. It compares
sets of instants as sets over continuous time. Tests compare the product with the oracle, over each transport.
"""

from tests.oracle.channel import Item, MustWait, OracleChannel, RefusedItem
from tests.oracle.consumers import OracleConsumers
from tests.oracle.reading import OracleAnswer, OracleGet, OracleReader
from tests.oracle.runs import Ack, OracleRetries, put_run
from tests.oracle.subscription import OracleNewest, OracleSubscription

__all__ = [
    "Ack",
    "Item",
    "MustWait",
    "OracleAnswer",
    "OracleChannel",
    "OracleConsumers",
    "OracleGet",
    "OracleNewest",
    "OracleReader",
    "OracleRetries",
    "OracleSubscription",
    "RefusedItem",
    "put_run",
]
