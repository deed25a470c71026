"""The one exception that a demo ends with when it cannot go on. Pure."""

from __future__ import annotations


class DemoFailed(Exception):
    """The demo cannot go on; the message is one sentence for the person in front of it: what, why, and the way out."""
