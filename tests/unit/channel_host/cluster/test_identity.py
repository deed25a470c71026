"""The identity of a host: its id in the data folder, and its name."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier
from typing import Any

import pytest

from stampede_rt_channel_host.cluster.identity import HomeCluster, default_name, load_host_id, new_boot_incarnation


def test_a_host_keeps_its_id_as_long_as_its_data_folder(tmp_path: Any) -> None:
    assert load_host_id(tmp_path / "new") == load_host_id(tmp_path / "new")
    assert load_host_id(None) != load_host_id(None)


def test_hosts_that_start_together_with_a_new_folder_have_one_id(tmp_path: Any) -> None:
    together = Barrier(4)

    def start(folder: Path) -> bytes:
        together.wait()
        return load_host_id(folder)

    with ThreadPoolExecutor(4) as starts:
        for number in range(20):
            folder = tmp_path / str(number)
            assert len({*starts.map(start, [folder] * 4), load_host_id(folder)}) == 1


def test_the_error_for_a_damaged_id_file_gives_advice(tmp_path: Any) -> None:
    (tmp_path / "host-id").write_text("what")
    with pytest.raises(ValueError, match="holds no host id; remove it"):
        load_host_id(tmp_path)


def test_the_error_for_a_damaged_cluster_file_gives_advice(tmp_path: Any) -> None:
    (tmp_path / "cluster-id").write_bytes(b"\xff")
    with pytest.raises(ValueError, match="holds no cluster id; remove it, and the host may register with any cluster"):
        HomeCluster(tmp_path)


def test_default_names_are_valid_and_differ() -> None:
    assert default_name() != default_name()
    assert default_name()[0].isalnum()
    assert new_boot_incarnation() != 0
