"""The errors of a supernode that was started with contradictory arguments."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from stampede_rt.errors import StampedeError
from stampede_rt_supernode.joining.founding import FoundingRecord, check_unused, misplacement_warning, restoring
from stampede_rt_supernode.replication import StoreRefused, restore_from
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.storage.sqlite_store import DATABASE_NAME
from stampede_rt_supernode.settings import SupernodeSettings
from tests.support.supernode.commands import prepared, status_has
from tests.support.supernode.list_machine import ListMachine
from tests.support.supernode.processes import free_ports

FOUNDER = Member(member_id="r", address="r:1")


@pytest.mark.parametrize(
    ("listed", "here", "advertise", "is_misplaced"),
    [
        ("10.0.0.1:7590", "10.0.0.1:7590", "", False),
        ("10.0.0.1:7590", "0.0.0.0:7590", "", False),
        ("localhost:7590", "127.0.0.1:7590", "", False),
        ("10.0.0.1:7590", "10.0.0.1:7591", "", True),
        ("10.0.0.1:7590", "127.0.0.1:7590", "", True),
        ("public:7590", "10.0.0.1:7591", "public:7590", False),
    ],
)
def test_a_supernode_that_listens_at_an_unlisted_address_reports_it(
    listed: str, here: str, advertise: str, is_misplaced: bool
) -> None:
    founding = FoundingRecord(supernode_id="a", address=listed, members={"a": listed})
    words = misplacement_warning(founding, here, advertise)
    assert (f"listens at {here}, but the others call it at {listed}" in words) is is_misplaced


def test_a_folder_with_an_unfinished_restore_is_reported(tmp_path: Path) -> None:
    folder = tmp_path / "new"
    folder.mkdir()
    (folder / DATABASE_NAME).touch()
    with pytest.raises(ZeroDivisionError), restoring(folder):
        raise ZeroDivisionError
    with pytest.raises(StampedeError, match=r"init --restore` failed or was interrupted there; empty the"):
        check_unused(folder)
    with pytest.raises(StampedeError, match=r"empty the folder, and run it again"):
        SupernodeSettings(data_dir=folder).founding("localhost:1")
    with restoring(tmp_path / "whole"):
        pass
    check_unused(tmp_path / "whole")
    with pytest.raises(ZeroDivisionError), restoring(tmp_path / "untouched"):
        raise ZeroDivisionError
    check_unused(tmp_path / "untouched")


def test_the_refusal_of_a_restore_names_the_fault_of_the_folder(tmp_path: Path) -> None:
    with pytest.raises(StoreRefused, match="nowhere does not exist"):
        restore_from(tmp_path / "nowhere", tmp_path / "new", ListMachine(), founder=FOUNDER, cluster_id="c")
    with pytest.raises(StoreRefused, match="is not the data folder of a supernode that has ever run"):
        restore_from(tmp_path, tmp_path / "new", ListMachine(), founder=FOUNDER, cluster_id="c")


async def test_the_error_names_a_missing_data_dir_as_soon_as_another_member_calls(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    ports = free_ports(2)
    founder = await prepared("init", "a", ports[0], tmp_path)
    other = None
    try:
        await founder.start()
        other = await prepared("join", "b", ports[1], tmp_path, "--member", founder.address)
        await other.start()
        await status_has(founder.address, "2 of 2 serve")
        await other.end(signal.SIGKILL)
        place = other._arguments.index("--data-dir")
        del other._arguments[place : place + 2]
        await other.start()
        await status_has(founder.address, "supernode-1 is there")
        printed = ""
        while "expects its member b here" not in printed:
            await status_has(founder.address, "supernode-1 is there")
            printed += capfd.readouterr().err
        assert "start it with the --data-dir of that member" in printed
    finally:
        for one in (founder, other):
            if one is not None:
                await one.close()
