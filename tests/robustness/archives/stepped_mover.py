"""A host that a test kills at a step while it moves a segment to the object store: see `stepped_host`."""

from __future__ import annotations

import sys

from stampede_rt_channel_host.archive.archive_end import ArchiveEnd
from stampede_rt_channel_host.archive.archive_folder import ArchiveFolder
from stampede_rt_channel_host.archive.host_archive import HostArchive
from stampede_rt_channel_host.archive.objects.known_objects import KnownObjects
from stampede_rt_channel_host.archive.objects.moving_files import MovingFiles
from stampede_rt_channel_host.archive.objects.opened_store import OpenedStore
from stampede_rt_channel_host.archive.objects.segment_mover import SegmentMover
from stampede_rt_channel_host.archive.objects.stored_segments import StoredSegments
from stampede_rt_channel_host.cluster.lease_thread import LeaseThread
from tests.robustness.moves.stepped_host import Step, run

MOVING = {
    "closes the file": Step(MovingFiles, "_end_segment"),
    "reads the file": Step(StoredSegments, "pack"),
    "has read the file": Step(StoredSegments, "pack", is_after=True),
    "makes the object": Step(OpenedStore, "create"),
    "has made the object": Step(OpenedStore, "create", is_after=True),
    "notes the object": Step(KnownObjects, "add"),
    "has noted the object": Step(KnownObjects, "add", is_after=True),
    "has deleted the file": Step(StoredSegments, "settle", is_after=True),
    "has settled the move": Step(MovingFiles, "settle", is_after=True),
}
DROPPING = {
    "drops an object": Step(StoredSegments, "remove_all"),
    "drops the object of a segment that has left": Step(StoredSegments, "remove"),
    "has noted that an object is dropped": Step(KnownObjects, "remove", is_after=True),
    "deletes objects": Step(OpenedStore, "delete"),
    "has deleted objects": Step(OpenedStore, "delete", is_after=True),
}
STARTING = {
    "lists the objects": Step(StoredSegments, "find"),
    "opens the files": Step(MovingFiles, "open_found"),
    "takes the objects over": Step(StoredSegments, "adopt", is_after=True),
    "notes all objects": Step(KnownObjects, "replace"),
    "has noted all objects": Step(KnownObjects, "replace", is_after=True),
}
STOPPING = {
    "begins to end the archive": Step(ArchiveEnd, "_finish"),
    "closes the files": Step(MovingFiles, "close"),
    "has closed the files": Step(MovingFiles, "close", is_after=True),
    "notes the stop of the host": Step(ArchiveFolder, "note_stop"),
    "has noted the stop of the host": Step(ArchiveFolder, "note_stop", is_after=True),
    "makes the last object": Step(OpenedStore, "create"),
    "makes the object of the stop": Step(SegmentMover, "_note_stop"),
    "has made the object of the stop": Step(SegmentMover, "_note_stop", is_after=True),
    "gives up the lease": Step(LeaseThread, "leave"),
    "has given up the lease": Step(LeaseThread, "leave", is_after=True),
    "closes the archive": Step(HostArchive, "close"),
}
TAKING = {
    "lists the objects of a former owner": Step(StoredSegments, "find"),
    "takes the stop": Step(StoredSegments, "take_stop"),
    "has taken the stop": Step(StoredSegments, "take_stop", is_after=True),
    "deletes the stop": Step(OpenedStore, "delete"),
    "has deleted the stop": Step(OpenedStore, "delete", is_after=True),
}

if __name__ == "__main__":
    sys.exit(run(MOVING | DROPPING | STARTING | STOPPING | TAKING))
