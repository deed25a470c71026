"""Rules of access in a running cluster: owners, answers for operators, and logs.

tests/contract/test_access.py has each verb, and the streams that end.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import grpc
import pytest

import stampede_rt as st
from stampede_rt.cli.commands import run
from stampede_rt.errors import PermissionDenied
from stampede_rt.security.credentials import call_metadata
from stampede_rt.v1 import access_service_pb2 as access_pb
from stampede_rt.v1 import access_service_pb2_grpc as access_grpc
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import channel_service_pb2_grpc as channel_grpc
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import directory_service_pb2_grpc as directory_grpc
from stampede_rt.v1 import gatekeeper_service_pb2 as gatekeeper_pb
from stampede_rt.v1 import gatekeeper_service_pb2_grpc as gatekeeper_grpc
from stampede_rt.v1 import group_directory_service_pb2 as group_pb
from stampede_rt.v1 import group_directory_service_pb2_grpc as group_grpc
from stampede_rt.v1 import peer_service_pb2 as peer_pb
from stampede_rt.v1 import peer_service_pb2_grpc as peer_grpc
from stampede_rt.v1 import queue_directory_service_pb2 as queue_pb
from stampede_rt.v1 import queue_directory_service_pb2_grpc as queue_grpc
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture
from tests.support.operator import Operator, operating
from tests.support.waiting import wait_until

cluster = cluster_fixture(hosts=2)


def refused(ask: Callable[[], Any]) -> str:
    """The error text that `ask` raises."""
    with pytest.raises(PermissionDenied) as caught:
        ask()
    return caught.value.message


@pytest.fixture
def operator(cluster: LocalCluster) -> Iterator[Operator]:
    with operating(cluster) as made:
        yield made


def things(cluster: LocalCluster) -> None:
    """Make the things that the tests use, as a caller to which no rule applies."""
    with st.connect(cluster.address) as rt:
        video = rt.channel("video/1", consumers=1)
        video.put(b"frame")
        rt.channel("video/2")
        rt.group("pair", [rt.channel("video/1"), rt.channel("video/2")])
        rt.queue("jobs").put(b"job")


def test_a_client_with_the_right_to_put_may_only_open_the_channel_and_put(
    cluster: LocalCluster, operator: Operator
) -> None:
    things(cluster)
    operator.add("cam", "put", "video/*", "--kind", "channel")
    with st.connect(cluster.address, secret=operator.token("cam")) as rt:
        channel = rt.channel("video/1")
        channel.put(b"x")
        assert "client cam may not read channel video/1" in refused(channel.newest)
        assert "may not create channel video/9" in refused(lambda: rt.channel("video/9"))
        assert "may not configure channel video/1" in refused(lambda: rt.channel("video/1", content_type="image/jpeg"))
        assert list(rt.channels()) == []


def test_only_a_caller_that_may_read_a_channel_sees_its_readers_and_writers(
    cluster: LocalCluster, operator: Operator
) -> None:
    things(cluster)
    operator.add("cam", "put", "video/*", "--kind", "channel")
    operator.add("dash", "read", "video/*", "--kind", "channel")
    with st.connect(cluster.address, secret=operator.token("cam")) as rt:
        rt.channel("video/2").put(b"x")
        hidden = rt.channel("video/2").stats()
    with st.connect(cluster.address, secret=operator.token("dash")) as rt:
        channel = rt.channel("video/2")
        with channel.subscribe():
            seen = channel.stats()
    assert (hidden.readers, hidden.writers, hidden.accepted) == (None, None, 1)
    assert [one.name for one in seen.writers] == ["cam"]
    assert [one.subscriber.partition("#")[0] for one in seen.readers] == ["dash"]


def test_no_caller_finds_the_host_of_a_hidden_channel_by_an_open_beside_it(
    cluster: LocalCluster, operator: Operator
) -> None:
    with st.connect(cluster.address) as rt:
        rt.channel("unseen/channel")
    operator.add("cam", "create,put", "video/*", "--kind", "channel")
    with st.connect(cluster.address, secret=operator.token("cam")) as rt:
        for name in ("unseen/channel", "unseen/not-there"):
            assert "cam may do nothing with" in refused(partial(rt.channel, "video/new", beside=name))


def test_no_error_shows_a_hidden_name_to_a_caller_that_gave_only_an_id(
    cluster: LocalCluster, operator: Operator
) -> None:
    """In an earlier version, a caller with only the id of a channel, queue, group or peer learned its name from an
    error, and also the owner of a peer.
    """
    with st.connect(cluster.address, name="unseen/peer") as rt:
        things(cluster)
        hidden = rt.channel("unseen/channel")
        channel, queue = hidden.info.channel_id, rt.queue("unseen/queue").info.queue_id
        group = rt.group("unseen/group", [hidden])
        rt.mailbox.get(timeout=0)
        [peer] = rt.peers("unseen/peer")
        hidden.put(b"x")
        host = next(one for one in rt.hosts() if one.host_id == hidden.info.host_id)
        operator.add("cam", "put", "video/*", "--kind", "channel")
        fields = {"request_id": bytes(range(16))}
        with grpc.insecure_channel(cluster.supernodes[0].address) as at:
            directory, groups = directory_grpc.DirectoryServiceStub(at), group_grpc.GroupDirectoryServiceStub(at)
            queues, peers = queue_grpc.QueueDirectoryServiceStub(at), peer_grpc.PeerServiceStub(at)
            calls = [
                (directory.ResolveChannel, directory_pb.ResolveChannelRequest(channel_id=channel)),
                (directory.DeleteChannel, directory_pb.DeleteChannelRequest(channel_id=channel, **fields)),
                (groups.ResolveGroup, group_pb.ResolveGroupRequest(group_id=group.info.group_id)),
                (groups.DeleteGroup, group_pb.DeleteGroupRequest(group_id=group.info.group_id, **fields)),
                (queues.ResolveQueue, queue_pb.ResolveQueueRequest(queue_id=queue)),
                (queues.DeleteQueue, queue_pb.DeleteQueueRequest(queue_id=queue, **fields)),
                (peers.ResolvePeer, peer_pb.ResolvePeerRequest(peer_id=peer.peer_id)),
                (peers.DeregisterPeer, peer_pb.DeregisterPeerRequest(peer_id=peer.peer_id, **fields)),
            ]
            error_texts = [denied(method, request, operator) for method, request in calls]
        with grpc.insecure_channel(host.endpoints[0]) as at:
            bind = gatekeeper_grpc.GatekeeperServiceStub(at).BindChannel
            status = channel_grpc.ChannelServiceStub(at).GetChannelStatus
            error_texts.append(denied(bind, gatekeeper_pb.BindChannelRequest(channel_id=channel, epoch=1), operator))
            error_texts.append(denied(status, channel_pb.GetChannelStatusRequest(channel_id=channel), operator))
    assert {text for text in error_texts if "unseen" in text} == set()
    assert all("client cam may do nothing with this" in text for text in error_texts), error_texts


def denied(method: Any, request: Any, operator: Operator) -> str:
    """The error text for a client that may only put."""
    with pytest.raises(grpc.RpcError) as caught:
        method(request, timeout=10, metadata=call_metadata(operator.token("cam")))
    assert caught.value.code() is grpc.StatusCode.PERMISSION_DENIED
    return f"{caught.value.details()} {caught.value.trailing_metadata()}"


def test_a_caller_needs_the_read_right_of_a_group_to_read_it_and_of_its_channels_to_create_it(
    cluster: LocalCluster, operator: Operator
) -> None:
    things(cluster)
    operator.add("dash", "read", "video/1")
    with st.connect(cluster.address, secret=operator.token("dash")) as rt:
        assert "dash may do nothing with group pair" in refused(lambda: rt.group("pair"))
        operator.add("dash", "create", "mine", "--kind", "group")
        operator.add("dash", "list", "video/2")
        mine = ("mine", [rt.channel("video/1"), rt.channel("video/2")])
        assert "dash may not read channel video/2" in refused(lambda: rt.group(*mine))
        operator.add("dash", "read", "video/2")
        assert rt.group(*mine).name == "mine"
        operator.add("dash", "read", "pair", "--kind", "group")
        assert rt.group("pair").name == "pair"


@pytest.mark.without_rules("it makes the rules itself")
def test_channels_queues_groups_and_peers_name_their_creators(
    cluster: LocalCluster, operator: Operator, capsys: pytest.CaptureFixture[str]
) -> None:
    with st.connect(cluster.address, secret=operator.token("maker"), name="maker-peer") as rt:
        rt.channel("by/maker")
        rt.queue("by/maker")
        rt.group("by/maker", [rt.channel("by/maker")])
        with st.connect(cluster.address) as other:
            made = other.channel("by/maker").info, other.queue("by/maker").info, other.groups("by/maker")[0]
            assert {one.created_by for one in made} == {"maker"}
            assert other.channel("by/nobody").info.created_by == "@cluster"
            assert [one.owner for one in other.peers("maker-peer")] == ["maker"]
        for words, key in (
            (["ls", "-l", "by/maker"], "created_by"),
            (["queue", "ls", "-l", "by/maker"], "created_by"),
            (["group", "ls", "by/maker"], "created_by"),
            (["peers", "maker-peer"], "owner"),
        ):
            capsys.readouterr()
            assert operator.run(*words, "-o", "json") == 0
            assert [row[key] for row in json.loads(capsys.readouterr().out)] == ["maker"]
        for words in (["info", "by/maker"], ["queue", "info", "by/maker"]):
            capsys.readouterr()
            assert operator.run(*words, "-o", "json") == 0
            assert json.loads(capsys.readouterr().out)["created_by"] == "maker"


def test_only_peers_own_their_mailboxes(cluster: LocalCluster, operator: Operator) -> None:
    operator.add("*", "register,send", "robot-*", "--kind", "peer")
    tokens = [operator.token(name) for name in ("robot-1", "thief")]
    with (
        st.connect(cluster.address, secret=tokens[0], name="robot-1") as robot,
        st.connect(cluster.address, secret=tokens[1], name="robot-2") as thief,
    ):
        thief.send("robot-1", b"hello")
        message = robot.mailbox.get(timeout=10)
        assert message is not None
        assert message.payload == b"hello"


def test_listings_and_watches_hide_things_that_the_caller_may_not_list(
    cluster: LocalCluster, operator: Operator
) -> None:
    """In an earlier version, a page token held the name of a hidden thing, and the change of a hidden thing made an
    empty response.
    """
    with (
        st.connect(cluster.address, name="hidden/peer") as rt,
        grpc.insecure_channel(cluster.supernodes[0].address) as supernode,
    ):
        things(cluster)
        channels = [rt.channel(f"hidden/{number}") for number in range(3)]
        rt.group("hidden/group", channels)
        rt.queue("hidden/queue")
        rt.queue("shown").put(b"x")
        operator.add("dash", "list", "shown")
        bearer = call_metadata(operator.token("dash"))
        pages = [
            *listed(
                directory_grpc.DirectoryServiceStub(supernode).ListChannels, directory_pb.ListChannelsRequest, bearer
            ),
            *listed(group_grpc.GroupDirectoryServiceStub(supernode).ListGroups, group_pb.ListGroupsRequest, bearer),
            *listed(
                queue_grpc.QueueDirectoryServiceStub(supernode).ListQueues,
                lambda **page: queue_pb.ListQueuesRequest(include_mailboxes=True, **page),
                bearer,
            ),
            *listed(peer_grpc.PeerServiceStub(supernode).ListPeers, peer_pb.ListPeersRequest, bearer),
        ]
        assert [len(page.queues) for page in pages if isinstance(page, queue_pb.ListQueuesResponse)] == [1]
        assert [page.next_page_token for page in pages] == [""] * 4
        watch = directory_grpc.DirectoryServiceStub(supernode).Watch(
            directory_pb.WatchRequest(include_queues=True), timeout=20, metadata=bearer
        )
        assert not next(watch).changes, "the first response only says where the watch begins"
        rt.channel("hidden/new")
        rt.queue("shown", max_items=7)
        assert [change.queue.name for change in next(watch).changes] == ["shown"]
        watch.cancel()


def listed(method: Any, request: Any, metadata: Any) -> list[Any]:
    """All pages of a list, with one thing on each page."""
    pages = [method(request(page_size=1), timeout=10, metadata=metadata)]
    while pages[-1].next_page_token:
        pages.append(method(request(page_size=1, page_token=pages[-1].next_page_token), timeout=10, metadata=metadata))
    return pages


def test_a_name_that_no_rule_gives_cannot_be_registered(cluster: LocalCluster, operator: Operator) -> None:
    operator.add("*", "register,send", "robot-*", "--kind", "peer")

    def register() -> None:
        with st.connect(cluster.address, secret=operator.token("thief"), name="boss") as rt:
            rt.mailbox.get(timeout=0)

    assert "client thief may not register peer boss" in refused(register)


@pytest.mark.without_rules("it makes the rules itself")
def test_a_caller_with_the_secret_of_the_cluster_may_do_everything_under_any_rules(
    cluster: LocalCluster, operator: Operator
) -> None:
    operator.add("*", "*", "*", "--deny")
    with st.connect(cluster.address) as rt:
        rt.channel("free").put(b"x")
        assert [one.name for one in rt.channels("free")] == ["free"]


@pytest.mark.without_rules("it makes the rules itself")
def test_an_operator_sees_the_effect_of_a_rule_and_the_reason_of_a_denial(
    cluster: LocalCluster, operator: Operator, capsys: pytest.CaptureFixture[str]
) -> None:
    things(cluster)
    assert operator.run("acl", "check", "cam", "put", "video/1") == 0
    assert "there are no rules" in capsys.readouterr().out
    assert operator.run("acl", "add", "cam", "put", "video/*", "--kind", "channel", "--dry-run") == 0
    printed = capsys.readouterr().out
    assert "would be added: allow cam put video/* (kind channel)" in printed
    assert "It is the first rule" in printed
    assert operator.run("acl", "ls") == 0
    assert "no rules" in capsys.readouterr().out
    operator.add("cam", "put", "video/*")
    operator.add("cam", "put", "video/1", "--deny")
    capsys.readouterr()
    assert operator.run("acl", "check", "cam", "put", "video/1") == 3
    explanation = capsys.readouterr().out
    assert "may not put channel video/1: the rule: deny cam put video/1" in explanation
    assert "If cam is an operator or a service of the cluster, rules do not limit it." in explanation
    # In an earlier version, the command took a pattern for a name.
    for words in (("cam", "put", "video/*"), ("cam-*", "put", "video/1")):
        assert operator.run("acl", "check", *words) == 2
        assert "* is a pattern; name one" in capsys.readouterr().err
    operator.add("cam", "send", "robot", "--kind", "peer")
    assert operator.run("acl", "check", "cam", "send", "robot") == 3
    assert "It may send peer robot (--kind peer)." in capsys.readouterr().out
    assert operator.run("acl", "check", "@cluster", "put", "video/1") == 0
    assert "@cluster may put channel video/1: no rule limits it" in capsys.readouterr().out
    assert operator.run("acl", "rm", "cam", "put", "video/1", "--deny", "--dry-run") == 0
    assert "put" in capsys.readouterr().out.split("The effects on cam")[1]
    assert operator.run("acl", "add", "cam", "put", "jobs", "--kind", "queue") == 2
    assert "nobody can put a queue" in capsys.readouterr().err


def test_doctor_says_that_rules_hide_things_from_its_caller(
    cluster: LocalCluster,
    operator: Operator,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """In an earlier version, doctor printed "0, none lost" and "Everything is well" although hidden channels were
    lost.
    """
    things(cluster)
    operator.add("cam", "put", "video/*")
    secret = tmp_path / "token"
    secret.write_text(operator.token("cam"))
    secret.chmod(0o600)
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(secret))
    capsys.readouterr()
    assert run(["doctor", "--url", cluster.address]) == 0
    printed = capsys.readouterr().out
    assert "0 that this caller may list, none lost" in printed
    assert "This caller sees no fault. Rules of access hide some channels" in printed


def test_a_serial_number_with_leading_zeros_revokes_the_certificate_that_has_it(cluster: LocalCluster) -> None:
    """In an earlier version, the supernode kept the serial number with its zeros, so the number matched no
    certificate.
    """
    metadata = call_metadata(cluster.secret.text)
    with grpc.insecure_channel(cluster.supernodes[0].address) as connection:
        stub: Any = access_grpc.AccessServiceStub(connection)
        for serial in ("000abc12", "00000000000abc13"):  # the second number has as many digits as a token's
            request = access_pb.RevokeCredentialRequest(request_id=secrets.token_bytes(16), serial=serial)
            stub.RevokeCredential(request, metadata=metadata, timeout=10)
        listed = stub.ListRevokedCredentials(
            access_pb.ListRevokedCredentialsRequest(), metadata=metadata, timeout=10
        ).serials
    assert {"abc12", "00000000000abc13"} <= set(listed)


def test_denials_and_changes_are_reported_in_the_logs_of_the_services(
    cluster: LocalCluster, operator: Operator
) -> None:
    things(cluster)
    operator.add("audited", "put", "video/1")
    with st.connect(cluster.address, secret=operator.token("audited")) as rt:
        channel = rt.channel("video/1")
        refused(channel.newest)
    logged = (
        ("who=audited proof=token", 'verb=read thing="channel video/1" result=denied'),
        ('verb="add rule"', "audited"),
    )
    for words in logged:
        wait_until(lambda words=words: audited(cluster, *words), f"an audit line with {words}")  # type: ignore[misc]


def audited(cluster: LocalCluster, *words: str) -> bool:
    lines = [line for process in cluster.processes() for line in process.last_lines]
    return any("logger=stampede_rt.audit" in line and all(word in line for word in words) for line in lines)


@pytest.mark.without_rules("it makes the rules itself")
def test_the_removal_of_an_unknown_rule_says_how_to_write_the_rule(
    operator: Operator, capsys: pytest.CaptureFixture[str]
) -> None:
    operator.add("cam", "put", "video/9", "--kind", "channel")
    capsys.readouterr()
    assert operator.run("acl", "rm", "cam", "put", "video/9") == 0
    printed = capsys.readouterr().out
    assert "The rule was not there: allow cam put video/9." in printed
    assert "Write it as `stampede acl ls` shows it, with --kind KIND" in printed


@pytest.mark.without_rules("it makes the rules itself")
def test_an_operator_sees_which_service_has_not_received_a_rule_yet(
    cluster: LocalCluster, operator: Operator, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stampede_rt.administration.in_force.IN_FORCE_SECONDS", 0.1)
    cluster.hosts[1].pause()
    try:
        assert operator.run("acl", "add", "late", "put", "video/1") == 0
        printed = capsys.readouterr()
    finally:
        cluster.hosts[1].resume()
        assert operator.run("acl", "rm", "late", "put", "video/1") == 0
    assert "The rule is added" in printed.out
    assert "not in force yet at host h2: " in printed.err
    assert "host h1" not in printed.err


def test_doctor_counts_the_denials_of_each_part(
    cluster: LocalCluster, operator: Operator, capsys: pytest.CaptureFixture[str]
) -> None:
    things(cluster)
    operator.add("counted", "put", "video/1")
    with st.connect(cluster.address, secret=operator.token("counted")) as rt:
        refused(rt.channel("video/1").newest)
        refused(lambda: rt.channel("video/2"))
    capsys.readouterr()
    assert operator.run("doctor", "-o", "json") == 0
    [row] = [row for row in json.loads(capsys.readouterr().out) if row["part"] == "access"]
    assert "calls denied, the last one" in row["state"]
    assert "host h" in row["state"]
    assert "supernode s" in row["state"]


def test_no_client_speaks_for_a_host(cluster: LocalCluster, operator: Operator) -> None:
    things(cluster)
    token = operator.token("forger")
    with st.connect(cluster.address) as rt:
        host_id = rt.hosts()[0].host_id
    target = cluster.supernodes[0].address
    request = peer_pb.RegisterPeerRequest(
        request_id=bytes(16), peer_id=b"p" * 16, boot_incarnation=1, host_id=host_id, registration_epoch=1
    )
    with grpc.insecure_channel(target) as channel, pytest.raises(grpc.RpcError) as caught:
        peer_grpc.PeerServiceStub(channel).RegisterPeer(request, timeout=10, metadata=call_metadata(token))
    assert "client forger may not speak for a host" in str(caught.value)
