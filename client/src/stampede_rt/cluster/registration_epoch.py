"""The number with which a process of a peer or host registers. It tells the directory which process is the newest.

Pure. See ERROR_REASON_STALE_REGISTRATION in proto/stampede_rt/v1/error.proto.
"""

from __future__ import annotations

from stampede_rt.errors import LeaseExpired, StaleRegistration

_EPOCH_KEY = "registration_epoch"  # the key of the directory's number in the metadata of a refusal


class RegistrationEpoch:
    """Holds the registration epoch of this process. Every registration of the process has `value`, at first 0."""

    def __init__(self) -> None:
        self.value = 0
        self._was_registered = False

    def note_registered(self) -> None:
        """Note that the directory has registered this process."""
        self._was_registered = True

    def may_overtake(self, refusal: StaleRegistration) -> bool:
        """Whether this process should register again. If so, makes `value` larger than the number in the refusal.

        Returns False if this process was registered before, and a newer live process has replaced it.
        """
        if self._was_registered and refusal.metadata.get("alive") != "false":
            return False
        self.value = max(self.value, int(refusal.metadata[_EPOCH_KEY]) + 1)
        return True

    def is_overtaken(self, refusal: LeaseExpired) -> bool:
        """Whether the directory refused a renewal because a newer process has registered.

        Returns False if the directory knows only an older process, as after the restore of a backup.
        """
        return int(refusal.metadata.get(_EPOCH_KEY, -1)) >= self.value
