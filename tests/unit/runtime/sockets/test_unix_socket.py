"""The folder and the paths of Unix sockets."""

from __future__ import annotations

import socket
import stat
from pathlib import Path

import pytest

from stampede_rt_runtime.listen import CannotListen
from stampede_rt_runtime.sockets.unix_socket import listen_at_new_path


def test_only_this_user_can_enter_the_folder(tmp_path: Path) -> None:
    listening, path = listen_at_new_path(tmp_path / "s")
    with listening:
        assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


def test_a_folder_that_others_can_enter_is_not_used(tmp_path: Path) -> None:
    tmp_path.chmod(0o755)
    with pytest.raises(CannotListen, match=f"is not a folder that only this user can enter.*chmod 700 {tmp_path}"):
        listen_at_new_path(tmp_path)
    link = tmp_path / "link"
    (tmp_path / "own").mkdir(mode=0o700)
    link.symlink_to(tmp_path / "own")
    with pytest.raises(CannotListen):
        listen_at_new_path(link)


def test_the_paths_of_dead_processes_are_removed_and_the_paths_of_live_processes_are_kept(tmp_path: Path) -> None:
    first, dead = listen_at_new_path(tmp_path / "s")
    first.close()
    second, alive = listen_at_new_path(tmp_path / "s")
    third, newest = listen_at_new_path(tmp_path / "s")
    with second, third:
        assert not dead.exists()
        assert sorted(path.name for path in alive.parent.iterdir()) == sorted([alive.name, newest.name])
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller:
            caller.connect(str(alive))


def test_the_error_for_a_too_long_path_names_a_remedy(tmp_path: Path) -> None:
    with pytest.raises(CannotListen, match="set a shorter"):
        listen_at_new_path(tmp_path / ("x" * 100))
