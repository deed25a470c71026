"""One target under atheris, in a process of its own: libFuzzer ends the process with its first finding."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

CORPUS = Path("out/fuzz")
INPUT_SECONDS_MAX = 20
MEMORY_MIB_MAX = 2048
INPUT_BYTES_MAX = 1200
INSTRUMENTED = ["stampede_rt", "stampede_rt_channel_host", "stampede_rt_supernode", "stampede_rt_runtime"]


def run_guided(name: str, *, inputs: int, seconds: int, seed: int) -> bool:
    """Whether nothing was found; libFuzzer prints the rest. Raises ImportError without atheris."""
    import atheris  # noqa: F401 - here, so that its absence is said before a process is started

    corpus = CORPUS / name
    corpus.mkdir(parents=True, exist_ok=True)
    words = [
        name,
        str(corpus),
        f"-runs={inputs}",
        f"-max_total_time={seconds}",
        f"-seed={seed}",
        "-print_final_stats=1",
    ]
    bounds = [f"-timeout={INPUT_SECONDS_MAX}", f"-rss_limit_mb={MEMORY_MIB_MAX}", f"-max_len={INPUT_BYTES_MAX}"]
    artifacts = f"-artifact_prefix={CORPUS}/found-{name}-"
    return subprocess.run([sys.executable, "-m", __name__, *words, *bounds, artifacts], check=False).returncode == 0


def fuzz(words: list[str]) -> None:
    """Run the fuzzer in a separate process. Never returns."""
    import atheris

    with atheris.instrument_imports(include=INSTRUMENTED):
        from tests.robustness.fuzz.parsers.catalogue import BY_NAME
    target = BY_NAME[words[0]]
    atheris.Setup([sys.argv[0], *words[1:]], target)
    atheris.Fuzz()


if __name__ == "__main__":
    fuzz(sys.argv[1:])
