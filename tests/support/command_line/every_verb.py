"""One command of each verb that prints something, for tests of all verbs against one running cluster."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

import stampede_rt as st
from stampede_rt.cli.contexts import Contexts
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.certs_command import main as certs
from tests.support.waiting import wait_until

MADE_BEFORE = ("moved", "gone", "configured", "proxied", "unproxied", "outside", "inside")


@dataclass(frozen=True)
class Stage:
    """The things that the commands work on: channels, groups and so on below `prefix`, and a folder with files.

    Each command may run once on a stage. Several stages may share a cluster.
    """

    rt: st.Connection
    folder: Path
    prefix: str
    leased: list[st.Message | None] = field(default_factory=list)

    @property
    def peer(self) -> str:
        """The peer of the stage's own connection."""
        return f"{self.prefix}-peer"

    @property
    def taker(self) -> str:
        """The peer that `mailbox get` registers."""
        return f"{self.prefix}-taker"

    def name(self, last: str) -> str:
        """The whole name of a channel, group or queue: `prefix` and `last`."""
        return f"{self.prefix}/{last}"

    def path(self, name: str) -> str:
        """The path of a file in the folder."""
        return str(self.folder / name)

    def other_host(self, channel: str) -> str:
        """A host that does not own the channel."""
        owner = self.rt.channels(self.name(channel))[0].host
        return next(host.name for host in self.rt.hosts() if host.name != owner)

    @contextmanager
    def busy(self) -> Iterator[None]:
        """Put items, make channels and send messages until the block ends, for commands that wait for a change."""
        over = threading.Event()
        thread = threading.Thread(target=self._make_changes, args=(over,), daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join(20)

    def _make_changes(self, over: threading.Event) -> None:
        left, right = (self.rt.channel(self.name(side)) for side in ("left", "right"))
        for number in count():
            if over.wait(0.02):
                return
            now = st.now()
            for channel in (left, right):
                channel.put(b"news", time=now)
            self.rt.channel(self.name(f"passing/{number}")).delete()
            with suppress(st.PeerNotFound):
                self.rt.send(self.taker, b"news")


@contextmanager
def stage(cluster: LocalCluster, folder: Path, prefix: str) -> Iterator[Stage]:
    """Make the things that the commands work on."""
    secret = cluster.secret_file.read_text().strip()
    with st.connect(cluster.address, secret=secret, name=f"{prefix}-peer") as rt:
        made = Stage(rt, folder, prefix)
        left, right = (rt.channel(made.name(side), max_age="1h") for side in ("left", "right"))
        for number in range(3):
            for channel in (left, right):
                channel.put(b"%d" % number, attributes={"k": "v"}, content_type="application/json")
        for name in MADE_BEFORE:
            rt.channel(made.name(name), max_age="1h").put(b"x")
        _make_groups_and_queues(made, left, right)
        rt.proxy(made.name("unproxied"), made.other_host("unproxied"))
        _make_files(made)
        used = rt.channel(made.name("used"), consumers=1, max_age="1h", replicas=1, ack="replica")
        with used.subscribe(st.OLDEST) as reader:
            used.put(b"x")
            used.consume(next(reader))
            yield made


def _make_groups_and_queues(made: Stage, left: st.Channel, right: st.Channel) -> None:
    rt = made.rt
    group = rt.group(made.name("group"), [left, right])
    rt.group(made.name("changed"), [left, rt.channel(made.name("inside"))])
    rt.group(made.name("gone"), [left])
    rt.queue(made.name("gone")).put(b"x")
    queue = rt.queue(made.name("queue"), lease="1h", replicas=1, ack="replica")
    rt.mailbox.configure(replicas=1, ack="replica")
    for _ in range(3):
        queue.put(b"x", attributes={"k": "v"})
    doomed = rt.queue(made.name("doomed"), dead_letter=rt.queue(made.name("dead")))
    doomed.put(b"x")
    message = doomed.get(timeout=20)
    assert message is not None
    message.term("for a test")
    rt.send(made.peer, b"x")
    now = st.now()
    for channel in (left, right):
        channel.put(b"3", time=now, attributes={"k": "v"}, content_type="application/json")
    wait_until(lambda: all(group.newest().values()))
    made.leased.extend([queue.get(timeout=20), rt.mailbox.get(timeout=20)])


def _make_files(made: Stage) -> None:
    with made.rt.record([made.name("left")], made.folder / "held.mcap", since="oldest", for_="0s") as recorder:
        recorder.wait()
    assert certs(["init", made.path("ca")]) == 0
    assert certs(["issue", "--dir", made.path("ca"), "--name", "cam", "--role", "client"]) == 0
    contexts = Contexts.load({"XDG_CONFIG_HOME": made.path("config")})
    contexts.by_name = {name: {"url": "localhost:1"} for name in ("every", "forgotten")}
    contexts.save()


Words = Callable[[Stage], Sequence[str]]
EVERY: dict[str, Words] = {
    "ls": lambda s: ["ls", s.name("left")],
    "ls -l": lambda s: ["ls", "-l", s.name("left")],
    "info": lambda s: ["info", s.name("used")],
    "hosts": lambda s: ["hosts"],
    "move": lambda s: ["move", s.name("moved"), s.other_host("moved")],
    "rebalance": lambda s: ["rebalance", "--over", "0.1s"],
    "put": lambda s: ["put", s.name("put"), "x"],
    "put --rate": lambda s: ["put", s.name("put"), "x", "--rate", "100", "--count", "2"],
    "rm": lambda s: ["rm", s.name("gone")],
    "configure": lambda s: ["configure", s.name("configured"), "--max-age", "2h"],
    "get": lambda s: ["get", s.name("left"), "--all"],
    "echo": lambda s: ["echo", s.name("left"), "--from", "oldest", "--count", "1"],
    "sub": lambda s: ["sub", s.name("left"), "--from", "oldest", "--count", "1"],
    "watch": lambda s: ["watch", "--count", "1"],
    "group ls": lambda s: ["group", "ls", s.name("group")],
    "group create": lambda s: ["group", "create", s.name("made"), s.name("left")],
    "group status": lambda s: ["group", "status", s.name("group")],
    "group newest": lambda s: ["group", "newest", s.name("group")],
    "group get": lambda s: ["group", "get", s.name("group"), "oldest", "newest"],
    "group watch": lambda s: ["group", "watch", s.name("group"), "--count", "1"],
    "group match": lambda s: [
        *("group", "match", s.name("group"), "--per", s.name("left"), "--tolerance", "1s", "--count", "1")
    ],
    "group add": lambda s: ["group", "add", s.name("changed"), s.name("outside")],
    "group remove": lambda s: ["group", "remove", s.name("changed"), s.name("inside")],
    "group delete": lambda s: ["group", "delete", s.name("gone")],
    "queue ls": lambda s: ["queue", "ls", s.name("queue")],
    "queue ls -l": lambda s: ["queue", "ls", "-l", s.name("queue")],
    "queue info": lambda s: ["queue", "info", s.name("queue")],
    "queue put": lambda s: ["queue", "put", s.name("queue"), "x"],
    "queue get": lambda s: ["queue", "get", s.name("dead"), "--keep", "--timeout", "20s"],
    "queue pending": lambda s: ["queue", "pending", s.name("queue")],
    "queue configure": lambda s: ["queue", "configure", s.name("queue"), "--max-items", "9000"],
    "queue delete": lambda s: ["queue", "delete", s.name("gone")],
    "peers": lambda s: ["peers", s.peer],
    "mailbox send": lambda s: ["mailbox", "send", s.peer, "x"],
    "mailbox get": lambda s: ["mailbox", "get", s.taker, "--timeout", "20s"],
    "mailbox pending": lambda s: ["mailbox", "pending", s.peer],
    "mailbox info": lambda s: ["mailbox", "info", s.peer],
    "proxy add": lambda s: ["proxy", "add", s.name("proxied"), s.other_host("proxied")],
    "proxy ls": lambda s: ["proxy", "ls", s.name("unproxied")],
    "proxy rm": lambda s: ["proxy", "rm", s.name("unproxied"), s.other_host("unproxied")],
    "replicas": lambda s: ["replicas", s.name("used")],
    "hz": lambda s: ["hz", s.name("left"), "--every", "0.05", "--count", "1"],
    "bw": lambda s: ["bw", s.name("left"), "--every", "0.05", "--count", "1"],
    "top": lambda s: ["top", s.name("left"), "--every", "0.05", "--count", "1"],
    "lag": lambda s: ["lag", s.name("*")],
    "record": lambda s: ["record", s.name("left"), "--since", "oldest", "--for", "0s", "--file", s.path("made.mcap")],
    "replay": lambda s: ["replay", s.path("held.mcap"), "--speed", "max", "--as", "replayed/"],
    "import": lambda s: ["import", s.path("held.mcap"), "--as", "imported/"],
    "export": lambda s: ["export", s.path("held.mcap"), "--file", s.path("made.csv")],
    "file info": lambda s: ["file", "info", s.path("held.mcap")],
    "file verify": lambda s: ["file", "verify", s.path("held.mcap")],
    "file recover": lambda s: ["file", "recover", s.path("held.mcap"), "--file", s.path("recovered.mcap")],
    "file cut": lambda s: ["file", "cut", s.path("held.mcap"), "--file", s.path("cut.mcap")],
    "file merge": lambda s: ["file", "merge", s.path("held.mcap"), "--file", s.path("merged.mcap")],
    "doctor": lambda s: ["doctor"],
    "acl add": lambda s: ["acl", "add", "every-*", "read", s.name("*")],
    "acl ls": lambda s: ["acl", "ls"],
    "acl check": lambda s: ["acl", "check", "every-one", "read", s.name("left")],
    "acl rm": lambda s: ["acl", "rm", "every-*", "read", s.name("*")],
    "quota set": lambda s: ["quota", "set", "every-*", "streams=100"],
    "quota ls": lambda s: ["quota", "ls"],
    "quota check": lambda s: ["quota", "check", "every-one"],
    "quota use": lambda s: ["quota", "use"],
    "quota rm": lambda s: ["quota", "rm", "every-*"],
    "context add": lambda s: ["context", "add", "every", "--url", "localhost:1"],
    "context use": lambda s: ["context", "use", "every"],
    "context ls": lambda s: ["context", "ls"],
    "context none": lambda s: ["context", "none"],
    "context rm": lambda s: ["context", "rm", "forgotten"],
    "token issue": lambda s: ["token", "issue", "every-one"],
    "token revoke": lambda s: ["token", "revoke", "0123456789abcdef"],
    "supernode status": lambda s: ["supernode", "status"],
    "supernode add": lambda s: ["supernode", "add", "localhost:1"],
    "supernode snapshot": lambda s: ["supernode", "snapshot"],
    "supernode init": lambda s: ["supernode", "init", "--data-dir", s.path("founded"), "--listen", "localhost:1"],
    "host drain": lambda s: ["host", "drain", s.rt.hosts()[0].name],
    "certs init": lambda s: ["certs", "init", s.path("another-ca")],
    "certs issue": lambda s: ["certs", "issue", "--dir", s.path("ca"), "--name", "one", "--role", "host"],
    "certs show": lambda s: ["certs", "show", s.path("ca/ca.pem")],
    "certs renew": lambda s: ["certs", "renew", s.path("ca/client-cam.pem"), "--dir", s.path("ca")],
    "certs revoke": lambda s: ["certs", "revoke"],
    "completion": lambda s: ["completion", "bash"],
    "demo": lambda s: ["demo"],
    "bench": lambda s: ["bench", "--help"],
}
"""The words of a command, by the verb and its variant. The commands may run in any order."""
WAITS_FOR_NEWS = ("watch", "group watch", "group match", "mailbox get")
"""The commands that wait until something changes, and then end. `Stage.busy` makes changes."""
WITHOUT_JSON = ("completion", "bench")
"""The commands that print no data."""
NOT_RUN = (
    *("supernode remove", "supernode join"),
    *("demo tv-watcher", "demo stereo", "demo rover"),
    *("bench paper", "bench matching", "bench growth", "bench capacity", "bench limits", "bench peers"),
)
"""The commands that need another supernode or a long time. Other tests compare the fields that these commands print."""
