"""The verbs of the command line: the module and the help of each. Pure. `stampede --help` loads this, and no verb."""

from __future__ import annotations

VERBS = {
    "ls": ("discovery", "list channels"),
    "info": ("discovery", "print a channel's policy and counters"),
    "hosts": ("hosts", "list hosts, with their channels and loads"),
    "move": ("move", "move a channel or queue to another host, while it is in use"),
    "rebalance": ("move", "show moves that would even out the loads of the hosts; with --apply perform them"),
    "put": ("putting", "put items; creates an absent channel"),
    "rm": ("changing", "delete channels with all their items, for everyone"),
    "configure": ("changing", "change a channel's policy, while it is in use"),
    "get": ("data", "print items by time; without times the newest one"),
    "echo": ("data", "print items as they come, until Ctrl-C"),
    "sub": ("merged", "print the items of all matching channels as one stream in the order of time, until Ctrl-C"),
    "watch": ("watching", "print channels, hosts and peers as they come and go, until Ctrl-C"),
    "group": ("group", "groups: channels that are read up to one common time"),
    "queue": ("queue", "queues: first in, first out, each message to one taker"),
    "peers": ("mailbox", "list peers: connections with a name"),
    "mailbox": ("mailbox", "messages to peers, by their names"),
    "proxy": ("proxy", "proxies: read-only copies of channels at other hosts, which serve readers"),
    "replicas": ("replicas", "list the replicas of a channel or queue, which become the owner if the owner is lost"),
    "hz": ("rates", "print items per second, jitter and lag of channels, until Ctrl-C"),
    "bw": ("rates", "print a channel's bytes per second, in and out, until Ctrl-C"),
    "top": ("top", "show the busiest channels, live, until q or Ctrl-C"),
    "lag": ("lag", "print how far channels, groups and queues are behind, the worst first"),
    "record": ("record", "record channels to an MCAP file, until Ctrl-C"),
    "replay": ("replay", "play an MCAP file, or channels, into channels"),
    "import": ("replay", "put the items of a file into channels"),
    "export": ("export", "write items of channels, or of a file, as MCAP, Parquet or CSV"),
    "file": ("file", "MCAP files: look at them, verify, recover, cut and merge them"),
    "doctor": ("doctor", "check every part of the cluster, and say what to fix"),
    "acl": ("acl", "rules of access, which say who may do what; for operators and holders of the cluster's secret"),
    "quota": (
        "quota",
        "quotas: how much one caller may use of a host or supernode; for operators and holders of the cluster's secret",
    ),
    "context": ("context", "saved addresses of clusters, with the files of their credentials"),
    "completion": ("completion", "print the script with which a shell completes commands"),
    "token": ("token", "tokens that prove a client's name and roles for a while"),
}
"""The verbs of clients, in the order of the help: the module of `stampede_rt.cli`, and the help."""

SERVICE_VERBS = {
    "dev": "run the whole system on this machine, in memory",
    "frontend": "run a front-end",
    "supernode": "run a supernode",
    "host": "run a channel host",
    "web": "serve a page that shows all streams on one time line",
    "certs": "make the certificates of a cluster",
    "demo": "run a demonstration on real media",
    "bench": "run a benchmark, such as the paper's figures",
}
"""The verbs that run parts of the system. Each is an entry point of the package that has it."""
