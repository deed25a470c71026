"""The error texts for refused payloads."""

from __future__ import annotations

import numpy as np
import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.payloads import check_payload


@pytest.mark.parametrize(
    ("payload", "way_out"),
    [
        (np.zeros(3), 'the payload is a ndarray; open the channel or queue with codec="numpy"'),
        ("text", "give text.encode\\(\\), or open"),
        ({"speed": 1}, 'codec="json"'),
        (None, "the payload is a NoneType; give bytes"),
    ],
)
def test_the_error_for_a_payload_that_is_not_bytes_names_a_fitting_codec(payload: object, way_out: str) -> None:
    with pytest.raises(InvalidArgument, match=way_out):
        check_payload(payload)
