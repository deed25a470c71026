"""Converts a step of the viewer to the fields of an event, and back. Pure."""

from __future__ import annotations

from stampede_rt_demos.staging.messages import BadMessage, Message
from stampede_rt_demos.tv_watcher.statistics import StepFigures


def step_fields(step: StepFigures) -> dict[str, object]:
    """Return a step as the fields of a `step` event."""
    return {
        "time": step.time,
        "end": step.end,
        "text": step.text,
        "counts": dict(step.counts),
        "complete": step.complete,
        "features_keep_times": step.features_keep_times,
        "received_unix_nano": step.received_unix_nano,
    }


def step_of(message: Message) -> StepFigures:
    """Return the step of a `step` event. Raises BadMessage if fields are missing."""
    try:
        return StepFigures(**{name: message[name] for name in StepFigures.__dataclass_fields__})
    except KeyError as error:
        raise BadMessage(f"the step lacks the field {error}") from None
