"""Check that proto/ does not break the accepted contract; with --accept make proto/ the accepted contract.

The accepted contract is an image of proto/ in `proto/stable.binpb`, which is committed. So the check needs no history,
and works in the same way in a shallow clone, in CI and on a branch. Additions pass. Run `--accept` in the commit that
changes the contract: its diff then shows a reviewer that the contract has changed.

A file with the mark UNSERVED has a design that no service implements. It is not part of the accepted contract, so its
first implementation may still change it. If a file was accepted before, the mark takes effect with --accept.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PROTO = ROOT / "proto"
STABLE = PROTO / "stable.binpb"
BUF_SECONDS_MAX = 60
UNSERVED = "// NOT SERVED YET."

# WIRE_JSON keeps old bytes readable by new code, and new bytes by old code. It allows the removal of RPCs, after which
# an older client would get UNIMPLEMENTED. The other rules forbid removals.
RULES = ["WIRE_JSON", "PACKAGE_NO_DELETE", "PACKAGE_SERVICE_NO_DELETE", "PACKAGE_MESSAGE_NO_DELETE", "RPC_NO_DELETE"]


class BufFailed(Exception):
    """buf could not do its work: it is missing, or proto/ does not compile. In the second case the text is from buf."""


def buf(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run buf of this environment. Raises BufFailed if there is none. The caller checks the exit status."""
    command = Path(sys.executable).parent / "buf"
    try:
        return subprocess.run(
            [command, *arguments], capture_output=True, text=True, timeout=BUF_SECONDS_MAX, check=False
        )
    except FileNotFoundError as error:
        raise BufFailed(f"{command} is missing; run: make setup") from error


def unserved(proto: Path) -> list[Path]:
    """Return the files in `proto` with the mark UNSERVED, in the order of their names."""
    return sorted(one for one in proto.rglob("*.proto") if _is_marked(one))


def _is_marked(source: Path) -> bool:
    return any(line.startswith(UNSERVED) for line in source.read_text().splitlines())


def build(proto: Path, out: Path) -> None:
    """Write the image of all served files in `proto`, without comments. The same sources give the same bytes.

    Raises BufFailed.
    """
    left_out = [word for one in unserved(proto) for word in ("--exclude-path", str(one))]
    done = buf("build", str(proto), "--exclude-source-info", "-o", str(out), *left_out)
    if done.returncode:
        raise BufFailed(done.stderr or done.stdout)


def violations(proto: Path, stable: Path) -> list[str]:
    """Return each way in which `proto` breaks the contract in the image `stable`, as a sentence. Raises BufFailed."""
    rules = json.dumps({"version": "v2", "breaking": {"use": RULES}})
    done = buf("breaking", str(proto), "--against", str(stable), "--config", rules, "--against-config", rules)
    if done.returncode == 0:
        return []
    if not done.stdout:  # violations go to stdout; errors of buf itself go to stderr
        raise BufFailed(done.stderr)
    return done.stdout.splitlines()


def image(proto: Path) -> bytes:
    """Return the image of `proto`. Raises BufFailed."""
    with tempfile.TemporaryDirectory() as folder:
        fresh = Path(folder) / "fresh.binpb"
        build(proto, fresh)
        return fresh.read_bytes()


def check(proto: Path, stable: Path) -> int:
    """Print the result of the check. Returns 0 if nothing breaks the contract."""
    if not stable.is_file():
        print(f"{stable} is missing, there is nothing to compare with; make it with: python tools/breaking.py --accept")
        return 2
    # First, because `buf breaking` would report sources that do not compile as if they were violations.
    fresh = image(proto)
    found = violations(proto, stable)
    for line in found:
        print(line)
    if found:
        print(
            f"{len(found)} breaking changes against {stable.name}. Older clients would fail: add instead of changing, "
            "or, if it must be, accept the new contract with: python tools/breaking.py --accept"
        )
        return 1
    left_out = unserved(proto)
    if left_out:
        print(f"not served yet, and not part of the accepted contract: {', '.join(one.name for one in left_out)}")
    if fresh != stable.read_bytes():
        print(f"{stable.name} does not protect the newest additions yet: python tools/breaking.py --accept")
    return 0


def main(arguments: list[str] | None = None) -> int:
    """Check, or with --accept renew the image."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--accept", action="store_true", help="accept the present proto/ as the contract")
    parser.add_argument("--proto", type=Path, default=PROTO, help="the folder of the .proto files")
    parser.add_argument("--stable", type=Path, default=STABLE, help="the image of the accepted contract")
    chosen = parser.parse_args(arguments)
    try:
        if chosen.accept:
            build(chosen.proto, chosen.stable)
            return 0
        return check(chosen.proto, chosen.stable)
    except BufFailed as error:
        print(error)
        return 2


if __name__ == "__main__":
    sys.exit(main())
