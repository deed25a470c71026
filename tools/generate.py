"""Generate the protobuf stubs and the blocking client; with --check tell whether the committed ones are up to date."""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from importlib.resources import files
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from tools.sync_rules import synchronous  # noqa: E402  (the folder is not an installed package)

PROTO = ROOT / "proto"
CLIENT = Path("client/src")
STUBS = CLIENT / "stampede_rt" / "v1"
SYNC = CLIENT / "stampede_rt" / "_sync"
ASYNC = CLIENT / "stampede_rt" / "_async"


def generate_stubs(out: Path) -> None:
    """Write the stubs of every .proto file below `out`, at the import path of its package."""
    (out / STUBS).mkdir(parents=True, exist_ok=True)
    sources = sorted(str(p.relative_to(PROTO)) for p in PROTO.rglob("*.proto"))
    target = out / CLIENT
    protoc = [sys.executable, "-m", "grpc_tools.protoc", f"-I{PROTO}", f"-I{files('grpc_tools') / '_proto'}"]
    subprocess.run([*protoc, f"--python_out={target}", f"--pyi_out={target}", *sources], check=True, cwd=PROTO)
    services = [source for source in sources if source.endswith("_service.proto")]
    plugin = f"--plugin=protoc-gen-mypy_grpc={Path(sys.executable).parent / 'protoc-gen-mypy_grpc'}"
    subprocess.run(
        [*protoc, plugin, f"--grpc_python_out={target}", f"--mypy_grpc_out=quiet:{target}", *services],
        check=True,
        cwd=PROTO,
    )
    (out / STUBS / "__init__.py").write_text('"""Generated from proto/stampede_rt/v1."""\n')


def generate_sync(out: Path) -> None:
    """Write the blocking client: the asynchronous one without `async` and `await`."""
    (out / SYNC).mkdir(parents=True, exist_ok=True)
    for source in sorted((ROOT / ASYNC).glob("*.py")):
        (out / SYNC / source.name).write_text(synchronous(source.read_text()))
    ruff = [sys.executable, "-m", "ruff", "--config", str(ROOT / "pyproject.toml"), "--quiet"]
    subprocess.run([*ruff, "check", "--select", "I", "--fix", "--no-cache", str(out / SYNC)], check=True, cwd=ROOT)
    subprocess.run([*ruff, "format", "--no-cache", str(out / SYNC)], check=True, cwd=ROOT)


def differences(fresh: Path) -> list[str]:
    """Return the generated files that are missing, stale or superfluous in the checkout."""
    found = []
    for folder in (STUBS, SYNC):
        names = {p.name for p in (fresh / folder).iterdir()} | {p.name for p in (ROOT / folder).glob("*.py*")}
        for name in sorted(names):
            new, old = fresh / folder / name, ROOT / folder / name
            if not (new.is_file() and old.is_file() and new.read_bytes() == old.read_bytes()):
                found.append(str(folder / name))
    return found


def main() -> int:
    """Generate, or with --check compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    if not arguments.check:
        generate_stubs(ROOT)
        generate_sync(ROOT)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        generate_stubs(Path(folder))
        generate_sync(Path(folder))
        stale = differences(Path(folder))
    for name in stale:
        print(f"{name} differs from the text that its source generates; run: make stubs")
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
