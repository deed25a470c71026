"""A part of the contract's tests, with rules of access that restrict their client. `make test-acl` runs all of them.

tests/integration/security/test_secured_contract.py runs another part with certificates and rules.
"""

# ruff: noqa: F401  # the tests come from tests/contract, and take this file's fixtures
from __future__ import annotations

from collections.abc import Iterator

import pytest

from stampede_rt_local.cluster import LocalCluster
from tests.contract.queues.conftest import rig
from tests.contract.queues.test_full_queues_and_dead_letters import (
    test_a_full_queue_makes_a_put_wait_or_refuses_it,
    test_a_message_delivered_too_often_goes_to_the_dead_letter_queue,
)
from tests.contract.queues.test_taking import (
    test_a_message_with_copies_is_delivered_to_that_many_takers,
    test_iteration_takes_one_message_after_the_other_until_the_handle_is_closed,
)
from tests.contract.test_groups import (
    surface,
    test_a_group_is_found_by_its_name_with_its_settings,
    test_deleting_a_group_keeps_its_channels,
    test_members_are_added_and_removed,
)
from tests.support.cluster import running_cluster


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STAMPEDE_TEST_ACL", "1")
        with running_cluster(hosts=2, supernodes=1) as made:
            yield made


@pytest.fixture(scope="module")
def grouped_cluster(cluster: LocalCluster) -> LocalCluster:
    return cluster
