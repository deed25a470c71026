"""All names of `import stampede_rt`. The package loads this module when a program first uses one of them."""

from __future__ import annotations

import os
import time

from stampede_rt._sync.channel import Channel
from stampede_rt._sync.connection import Connection
from stampede_rt._sync.cuts import CutSubscription
from stampede_rt._sync.group import Group
from stampede_rt._sync.group_channel import GroupChannel
from stampede_rt._sync.listener import Listener
from stampede_rt._sync.matches import MatchSubscription
from stampede_rt._sync.message import Message
from stampede_rt._sync.presence import Mailbox
from stampede_rt._sync.producer import Producer
from stampede_rt._sync.queue import Queue
from stampede_rt._sync.sampler import Sampler
from stampede_rt._sync.session import Session
from stampede_rt._sync.subscription import Subscription
from stampede_rt._sync.watch import PeerWatch, Watch
from stampede_rt.cluster.connecting import Target, parse_target
from stampede_rt.cluster.embedding import HostOptions, InProcessHost, embedder
from stampede_rt.errors import (
    AheadOfClock,
    ChannelExists,
    ChannelFull,
    ChannelNotFound,
    CodecError,
    DeadlineExceeded,
    FileError,
    ForkedProcess,
    Full,
    GroupExists,
    GroupNotFound,
    HostExists,
    HostNotFound,
    IncarnationLost,
    InFuture,
    InvalidArgument,
    InvalidInterval,
    InvalidName,
    ItemTooLarge,
    LeaseExpired,
    MoveConflict,
    NotArchived,
    NotReplicated,
    Overloaded,
    PeerExists,
    PeerNotFound,
    PermissionDenied,
    QueueExists,
    QueueFull,
    QueueNotFound,
    StampedeError,
    TooOld,
    Unavailable,
    VersionMismatch,
    WatchRestart,
    WrongCluster,
    WrongEventLoop,
)
from stampede_rt.pickling import ClusterReference
from stampede_rt.security.tls import TlsFiles
from stampede_rt.values.answers import ItemBatch, Items
from stampede_rt.values.balancing import PlannedMove
from stampede_rt.values.codecs import Codec, CodecLike
from stampede_rt.values.grouping import (
    ByChannel,
    CrossSection,
    Cut,
    GroupInfo,
    GroupStatus,
    Matched,
    MemberStatus,
    NewestItems,
)
from stampede_rt.values.model import (
    Ack,
    Change,
    ChannelInfo,
    HostInfo,
    Item,
    LoadInfo,
    OnFull,
    Policy,
    Reason,
    SupernodeInfo,
)
from stampede_rt.values.peering import ClockOffset, PeerChange, PeerInfo
from stampede_rt.values.proxying import CopyStats, DrainInfo, MoveInfo, ProxyInfo
from stampede_rt.values.queueing import DeadLetterOrigin, Enqueued, PendingMessage, QueueInfo, QueuePolicy, QueueStats
from stampede_rt.values.reading import SubscribeMode
from stampede_rt.values.recording import RecordedCounts, RecordingGap, RecordingSummary
from stampede_rt.values.statistics import (
    ArchiveStats,
    ChannelMulticastStats,
    ChannelStats,
    ConsumerStats,
    MulticastStats,
    ReaderStats,
    WriterStats,
)
from stampede_rt.values.timeline import (
    NEWEST,
    NOW,
    OLDEST,
    Bound,
    BoundLike,
    Bounds,
    DurationLike,
    InstantLike,
    MatchLike,
    ResolvedInterval,
    last,
)
from stampede_rt.version import VERSION as __version__  # noqa: N811

__all__ = [
    "NEWEST",
    "NOW",
    "OLDEST",
    "Ack",
    "AheadOfClock",
    "ArchiveStats",
    "Bound",
    "BoundLike",
    "Bounds",
    "ByChannel",
    "Change",
    "Channel",
    "ChannelExists",
    "ChannelFull",
    "ChannelInfo",
    "ChannelMulticastStats",
    "ChannelNotFound",
    "ChannelStats",
    "ClockOffset",
    "Codec",
    "CodecError",
    "CodecLike",
    "Connection",
    "ConsumerStats",
    "CopyStats",
    "CrossSection",
    "Cut",
    "CutSubscription",
    "DeadLetterOrigin",
    "DeadlineExceeded",
    "DrainInfo",
    "DurationLike",
    "Enqueued",
    "FileError",
    "ForkedProcess",
    "Full",
    "Group",
    "GroupChannel",
    "GroupExists",
    "GroupInfo",
    "GroupNotFound",
    "GroupStatus",
    "HostExists",
    "HostInfo",
    "HostNotFound",
    "InFuture",
    "IncarnationLost",
    "InstantLike",
    "InvalidArgument",
    "InvalidInterval",
    "InvalidName",
    "Item",
    "ItemBatch",
    "ItemTooLarge",
    "Items",
    "LeaseExpired",
    "Listener",
    "LoadInfo",
    "Mailbox",
    "MatchLike",
    "MatchSubscription",
    "Matched",
    "MemberStatus",
    "Message",
    "MoveConflict",
    "MoveInfo",
    "MulticastStats",
    "NewestItems",
    "NotArchived",
    "NotReplicated",
    "OnFull",
    "Overloaded",
    "PeerChange",
    "PeerExists",
    "PeerInfo",
    "PeerNotFound",
    "PeerWatch",
    "PendingMessage",
    "PermissionDenied",
    "PlannedMove",
    "Policy",
    "Producer",
    "ProxyInfo",
    "Queue",
    "QueueExists",
    "QueueFull",
    "QueueInfo",
    "QueueNotFound",
    "QueuePolicy",
    "QueueStats",
    "ReaderStats",
    "Reason",
    "RecordedCounts",
    "RecordingGap",
    "RecordingSummary",
    "ResolvedInterval",
    "Sampler",
    "StampedeError",
    "SubscribeMode",
    "Subscription",
    "SupernodeInfo",
    "TlsFiles",
    "TooOld",
    "Unavailable",
    "VersionMismatch",
    "Watch",
    "WatchRestart",
    "WriterStats",
    "WrongCluster",
    "WrongEventLoop",
    "__version__",
    "connect",
    "host",
    "last",
    "now",
]


def connect(
    url: str | None = None,
    *,
    name: str | None = None,
    proof: str | None = None,
    secret: str | os.PathLike[str] | None = None,
    zone: str | None = None,
    tls: TlsFiles | None = None,
    transport: str | None = None,
) -> Connection:
    """Connect to a cluster through its front-ends.

    - `url`: the addresses of the front-ends, as "host:port,host:port". Default: `$STAMPEDE_URL`, or localhost:7580.
    - `name`: the name under which this connection is a peer. A peer has a mailbox, to which others can send.
    - `proof`: a secret text of 16 characters or more that the program keeps over restarts. A restarted program that
      gives the same proof takes over the name and the mailbox immediately.
    - `secret`: the cluster's secret or a client token, or the path of its file (a `pathlib.Path`). The client reads a
      file again when it has changed. On the cluster's own machine the client finds the secret by itself.
    - `zone`: the name of the caller's network or site. The client prefers supernodes of the same zone.
    - `tls`: the certificates, if the cluster asks for them.
    - `transport`: how data goes between this program and the hosts. "best": over sockets where that is possible,
      otherwise over gRPC, and from shared memory if a program reads a channel often. "grpc": always over gRPC.
      "socket": over Unix or TCP sockets, with an error where that is not possible. "tcp": as "socket", but only
      over TCP. "shared": over Unix sockets, and from shared memory from the first read on, with an error where a host
      shares none. Default: `$STAMPEDE_TRANSPORT`, or "best".

    Blocks for at most 5 s.
    Raises Unavailable, PermissionDenied, VersionMismatch, WrongCluster, PeerExists, InvalidArgument.
    """
    target = parse_target(url, name=name, secret=secret, zone=zone, tls=tls, transport=transport)
    return _opened(target, secret, transport, proof, None)


def _opened(
    target: Target,
    secret: str | os.PathLike[str] | None,
    transport: str | None,
    proof: str | None,
    in_process_host: InProcessHost | None,
) -> Connection:
    address = ClusterReference.of(target, secret, transport)
    session = Session(
        target.frontends,
        target.credentials,
        peer_name=target.name,
        zone=target.zone,
        transport=target.transport,
        reopening=address,
    )
    try:
        return Connection(session, target.name, proof)._open(in_process_host)
    except BaseException:
        session.close()
        raise


def host(
    url: str | None = None,
    *,
    name: str | None = None,
    proof: str | None = None,
    secret: str | os.PathLike[str] | None = None,
    zone: str | None = None,
    tls: TlsFiles | None = None,
    transport: str | None = None,
    listen: str | None = None,
    advertise: str | None = None,
    max_memory: int | str = "1GiB",
    drain: DurationLike = "5s",
    allow_insecure_anywhere: bool = False,
    private: bool = False,
    archive: str | os.PathLike[str] | None = None,
    archive_folder: str | os.PathLike[str] | None = None,
    max_archive: int | str | None = None,
) -> Connection:
    """Connect to a cluster, and make this process a channel host of it (docs/embedding.md).

    New channels and queues of this connection are at this host, unless the call names another place. All programs of
    the cluster can use them. The directory may place channels of other programs here, unless the host is `private`.

    - `name`: the name of the host, and of this connection as a peer. Default: the host gets the machine's name with a
      random end, and the connection is not a peer. With certificates the host has the certificate's name.
    - `listen`: the address at which the host listens, as "HOST:PORT". Default: any free port at localhost. If a
      front-end is on another machine: any free port at this machine's address towards it. The host then needs
      certificates.
    - `advertise`: the address at which others reach the host. Default: `listen`.
    - `max_memory`: the most memory that all items at this host may use, in bytes or as "512MiB". Beyond it the host
      refuses puts.
    - `allow_insecure_anywhere`: listen beyond this machine without certificates, on a network that you trust.
    - `private`: the directory places channels, queues and copies of other programs here only if they name this host.
    - `drain`: when the connection closes, the host moves its channels to other hosts for at most this time. "0s": it
      moves none, and their items are lost, unless they are in an archive.
    - `archive`: the folder, of this host alone, for recorded channels and the host's identity; or the URL of an object
      store, such as "s3://BUCKET/PREFIX" (extra [objects]). Default: none; the host ignores `$STAMPEDE_ARCHIVE`.
    - `archive_folder`: with a URL in `archive`, the folder for files that have not moved to the object store. Default:
      `~/.local/state/stampede/archive`.
    - `max_archive`: the most bytes of the archive on its disk, such as "200GiB". Default: 9/10 of the disk's free room.

    The other arguments are as in `connect`. The host needs the cluster's secret, or a certificate of the role host.

    Blocks for at most 35 s. `close` blocks for `drain` and some seconds more.
    Raises HostExists, the errors of `connect`, and InvalidArgument if the extra [server] is not installed.
    """
    options = HostOptions.parse(
        listen, advertise, max_memory, drain, allow_insecure_anywhere, private, archive, archive_folder, max_archive
    )
    target = parse_target(url, name=name, secret=secret, zone=zone, tls=tls, transport=transport)
    return _opened(target, secret, transport, proof, embedder()(target, options))


def now() -> int:
    """Return the time of this machine's clock, in nanoseconds since the epoch.

    A host's clock may differ, see `Channel.stats`.
    """
    return time.time_ns()
