"""Small copies of JPEG pictures, for measuring and for drawing."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image


def encode_jpeg(image: Image.Image, quality: int) -> bytes:
    """Return the image as JPEG. `quality` is as in Pillow, 1 to 95."""
    encoded = io.BytesIO()
    image.save(encoded, "JPEG", quality=quality)
    return encoded.getvalue()


def luma_thumbnail(jpeg: bytes, width: int, height: int) -> NDArray[np.uint8]:
    """Return the brightness of a JPEG picture, as an array (height, width). The decoder skips fine detail."""
    with Image.open(io.BytesIO(jpeg)) as image:
        image.draft("L", (width, height))
        return np.asarray(image.convert("L").resize((width, height), Image.Resampling.BOX))


def jpeg_thumbnail(jpeg: bytes, width: int, height: int, quality: int) -> bytes:
    """Return a small copy of a JPEG picture."""
    with Image.open(io.BytesIO(jpeg)) as image:
        return encode_jpeg(image.resize((width, height), Image.Resampling.LANCZOS), quality)
