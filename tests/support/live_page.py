"""The page of `stampede web` as a process, and requests to it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar
from urllib.error import HTTPError
from urllib.parse import urlencode
from urllib.request import urlopen

from stampede_rt_local.process import ServiceProcess
from tests.support.waiting import wait_until

READY_SECONDS = 40.0
ANSWER_SECONDS = 30.0

Found = TypeVar("Found")


class LivePage:
    """A running page. `url` ends with a slash."""

    def __init__(self, url: str) -> None:
        self.url = url

    def ask(self, path: str, **parameters: Any) -> tuple[int, dict[str, Any]]:
        """Return the status and the JSON of an answer. A parameter with a list is sent once for each value."""
        try:
            with urlopen(f"{self.url}api/{path}?{urlencode(parameters, doseq=True)}", timeout=ANSWER_SECONDS) as answer:
                return answer.status, json.load(answer)
        except HTTPError as error:
            text = error.read().decode()
            is_json = error.headers["content-type"] == "application/json"
            return error.code, json.loads(text) if is_json else {"failure": text}


@contextmanager
def live_page(cluster_address: str, *arguments: str) -> Iterator[LivePage]:
    """Run the page for the cluster at `cluster_address`, with the secret that $STAMPEDE_SECRET_FILE names."""
    secret_file = os.environ["STAMPEDE_SECRET_FILE"]
    words = ["--listen", "localhost:0", "--url", cluster_address, "--secret-file", secret_file, *arguments]
    process = ServiceProcess("the page", "stampede_rt_web", words)
    try:
        process.start()
        yield LivePage(process.wait_ready(READY_SECONDS))
    finally:
        process.stop()


def eventually(find: Callable[[], Found | None]) -> Found:
    """Call `find` until it returns a true value, and return the value. Fails after the time of `wait_until`."""
    found: list[Found] = []

    def holds() -> bool:
        one = find()
        if one:
            found.append(one)
        return bool(found)

    wait_until(holds)
    return found[0]
