"""OpenTelemetry spans of a program's logical calls, if the program has configured an SDK (decision 0180).

Without `opentelemetry-api` (`stampede-rt[otel]`), or without an SDK, there are no spans. This module imports nothing of
OpenTelemetry before the program has done so.
"""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager
from typing import Any

TRACER = "stampede_rt"


class _NoSpan:
    """Does nothing. One object serves all calls."""

    def __enter__(self) -> None:
        pass

    def __exit__(self, *exc_info: object) -> None:
        pass


_NO_SPAN = _NoSpan()


def trace_api() -> Any:
    """Return the module `opentelemetry.trace` if the program has configured an SDK; otherwise None."""
    trace = sys.modules.get("opentelemetry.trace")
    if trace is None or isinstance(trace.get_tracer_provider(), trace.ProxyTracerProvider):
        return None
    return trace


def span(call: str, **subject: str) -> AbstractContextManager[Any]:
    """Return a context manager: the span of one logical call, such as "put". `subject`: what the call is about.

    An exception in the block marks the span as failed, and passes on.
    """
    trace = trace_api()
    if trace is None:
        return _NO_SPAN
    attributes = {f"stampede.{kind}": name for kind, name in subject.items()}
    tracer = trace.get_tracer(TRACER)
    made: AbstractContextManager[Any] = tracer.start_as_current_span(
        f"stampede {call}", kind=trace.SpanKind.CLIENT, attributes=attributes
    )
    return made


def trace_metadata() -> tuple[tuple[str, str], ...]:
    """Return the metadata of an RPC that belongs to the present span: `traceparent`, and others that are configured."""
    trace = trace_api()
    if trace is None or not trace.get_current_span().is_recording():
        return ()
    from opentelemetry import propagate

    carrier: dict[str, str] = {}
    propagate.inject(carrier)
    return tuple(carrier.items())
