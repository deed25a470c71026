"""The number with which a process registers, so that the directory knows it from older processes of its peer or host.

Pure. See ERROR_REASON_STALE_REGISTRATION in proto/stampede_rt/v1/error.proto.
"""

from __future__ import annotations

from stampede_rt.errors import LeaseExpired, StaleRegistration

_TOLD = "registration_epoch"


class RegistrationEpoch:
    """`value` goes into every registration of this process. It starts at 0, which a first process needs."""

    def __init__(self) -> None:
        self.value = 0
        self._was_registered = False

    def note_registered(self) -> None:
        """The directory has let this process in."""
        self._was_registered = True

    def may_overtake(self, refusal: StaleRegistration) -> bool:
        """Whether to register again at once, with the `value` that is then above the one reached.

        False: the other process came after this one was registered, and lives. It has taken this one's place.
        """
        if self._was_registered and refusal.metadata.get("alive") != "false":
            return False
        self.value = max(self.value, int(refusal.metadata[_TOLD]) + 1)
        return True

    def is_overtaken(self, refusal: LeaseExpired) -> bool:
        """Whether a renewal was refused because a newer process lives. An older one, of a restored backup, does not
        count."""
        return int(refusal.metadata.get(_TOLD, -1)) >= self.value
