"""Parsers that decide about rights: client tokens, and rules as operators write them."""

from __future__ import annotations

from stampede_rt.errors import InvalidArgument, PermissionDenied
from stampede_rt.v1 import access_pb2
from stampede_rt_runtime.access.caller import Caller, CallerKind
from stampede_rt_runtime.access.credentials import AcceptedCredentials, identify
from stampede_rt_runtime.access.messages import rule_from, rule_message
from stampede_rt_runtime.access.rules import AccessKind, AccessRules, AccessVerb, check_rule
from stampede_rt_runtime.access.tokens import TokenClaims, make_token, public_key, read_token
from stampede_rt_runtime.identity import Role
from tests.robustness.fuzz import hostile_values
from tests.robustness.fuzz.drawing import ByteSource
from tests.robustness.fuzz.messages import KnownValues, drawn_message
from tests.robustness.fuzz.parsers.target import Target
from tests.robustness.fuzz.parsers.texts import composed

KEY = b"k" * 32
KNOWN = KnownValues()
KNOWN.add("who", "a", "*", "cam-*", "@clients", "*a*a*a*a*a*a*b")
KNOWN.add("names", "a", "*", "cam/*", "?", "*a*a*a*a*a*a*b")
KNOWN.add("verbs", *range(1, 10))
KNOWN.add("kind", 0, 1, 2, 3, 4)


def client_token(source: ByteSource) -> None:
    """Change a token as the input says. Check that the cluster refuses the text, or reads the same claims from it."""
    claims = TokenClaims(cluster_id="c", name="a", roles=(Role.CLIENT,), serial="1", ends_unix_nano=10**18)
    real = make_token(KEY, claims)
    at = source.below(len(real))
    forged = composed(source) if source.chance(30) else real[:at] + composed(source) + real[at + source.below(3) :]
    read = read_token(forged, keys=[public_key(KEY)], cluster_id="c")
    assert read == claims, f"a forged token is believed: {forged!r}"


def credential(source: ByteSource) -> None:
    """Check that no header without a secret admits its caller."""
    sent_credentials = source.choice((None, hostile_values.blob(source), b"Bearer " + hostile_values.blob(source)))
    caller = identify(AcceptedCredentials(secrets=("the secret of the cluster",)), sent_credentials, None)
    raise AssertionError(f"{caller} was accepted with {sent_credentials!r}")


def rule(source: ByteSource) -> None:
    """Check that an accepted rule is the same after encoding and decoding, and can judge every caller and name."""
    drawn = [drawn_message(source, access_pb2.AccessRule.DESCRIPTOR, KNOWN) for _ in range(1 + source.below(4))]
    rules = [rule_from(one) for one in drawn]  # type: ignore[arg-type]
    for one in rules:
        check_rule(one)
        assert rule_from(rule_message(one)) == one
    caller = Caller(kind=CallerKind.TOKEN, roles=frozenset({Role.CLIENT}), name=composed(source))
    judging = AccessRules(rules)
    for name in ("a" * 128, composed(source)):
        for kind in AccessKind:
            ruling = judging.judge(caller, source.choice(tuple(AccessVerb)), kind, name)
            assert ruling.rule is None or ruling.rule.deny is not ruling.allowed


TARGETS = (
    Target("client_token", client_token, (PermissionDenied,)),
    Target("credential", credential, (PermissionDenied,)),
    Target("rule", rule, (InvalidArgument,)),
)
