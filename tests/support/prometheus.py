"""A real Prometheus that scrapes a cluster."""

from __future__ import annotations

import json
import subprocess
import time
import urllib.parse
import urllib.request
from collections.abc import Callable
from pathlib import Path

from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.ports import free_ports

SECONDS = 60
RULES = Path(__file__).parents[2] / "deploy" / "prometheus" / "alerts.yml"


class Prometheus:
    """A Prometheus that scrapes the cluster each second."""

    def __init__(self, cluster: LocalCluster, folder: Path) -> None:
        self.port = free_ports(1)[0]
        targets = [{"targets": [where], "labels": {"part": name}} for name, where in cluster.metrics.items()]
        jobs = [{"job_name": "stampede", "scrape_interval": "1s", "scrape_timeout": "1s", "static_configs": targets}]
        config = {"global": {"evaluation_interval": "1s"}, "rule_files": [str(RULES)], "scrape_configs": jobs}
        (folder / "prometheus.yml").write_text(json.dumps(config))  # JSON is YAML, too
        self._process = subprocess.Popen(
            [
                "prometheus",
                f"--config.file={folder / 'prometheus.yml'}",
                f"--storage.tsdb.path={folder / 'data'}",
                f"--web.listen-address=127.0.0.1:{self.port}",
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def ask(self, query: str) -> list[tuple[dict[str, str], float]]:
        """The present values of an expression."""
        url = f"http://127.0.0.1:{self.port}/api/v1/query?{urllib.parse.urlencode({'query': query})}"
        with urllib.request.urlopen(url, timeout=10) as answer:
            found = json.load(answer)["data"]["result"]
        return [(one["metric"], float(one["value"][1])) for one in found]

    def until(self, query: str, holds: Callable[[list[float]], bool]) -> list[float]:
        """Ask until `holds` returns True for the values. Returns the values."""
        end_s, values = time.monotonic() + SECONDS, list[float]()
        while time.monotonic() < end_s:
            try:
                values = [value for _, value in self.ask(query)]
            except OSError:  # the server is still starting
                values = []
            if holds(values):
                return values
            time.sleep(0.1)
        raise AssertionError(f"{query} is {values} after {SECONDS} s")

    def stop(self) -> None:
        self._process.terminate()
        self._process.wait(10)
