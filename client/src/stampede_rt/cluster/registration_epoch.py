"""The number with which a process registers. By it the directory recognises older processes of the peer or host.

Pure. See ERROR_REASON_STALE_REGISTRATION in proto/stampede_rt/v1/error.proto.
"""

from __future__ import annotations

from stampede_rt.errors import LeaseExpired, StaleRegistration

_TOLD = "registration_epoch"


class RegistrationEpoch:
    """Counts the registration epoch. `value` goes into every registration of this process. It starts at 0."""

    def __init__(self) -> None:
        self.value = 0
        self._was_registered = False

    def note_registered(self) -> None:
        """Note that the directory has registered this process."""
        self._was_registered = True

    def may_overtake(self, refusal: StaleRegistration) -> bool:
        """Whether to register again at once. If so, makes `value` larger than the number in the refusal.

        Returns False if this process was registered, and a newer process that is alive has replaced it.
        """
        if self._was_registered and refusal.metadata.get("alive") != "false":
            return False
        self.value = max(self.value, int(refusal.metadata[_TOLD]) + 1)
        return True

    def is_overtaken(self, refusal: LeaseExpired) -> bool:
        """Whether the directory refused a renewal because a newer process lives.

        An older process, which a restored backup may name, does not count.
        """
        return int(refusal.metadata.get(_TOLD, -1)) >= self.value
