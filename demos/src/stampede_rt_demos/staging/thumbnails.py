"""Small copies of JPEG pictures, for measuring and for drawing."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image


def encode_jpeg(image: Image.Image, quality: int) -> bytes:
    """The image as JPEG; `quality` is Pillow's, 1 to 95."""
    encoded = io.BytesIO()
    image.save(encoded, "JPEG", quality=quality)
    return encoded.getvalue()


def luma_thumbnail(jpeg: bytes, width: int, height: int) -> NDArray[np.uint8]:
    """The brightness of a JPEG picture in `height` rows of `width`; the decoder skips the finer detail."""
    with Image.open(io.BytesIO(jpeg)) as image:
        image.draft("L", (width, height))
        return np.asarray(image.convert("L").resize((width, height), Image.Resampling.BOX))


def jpeg_thumbnail(jpeg: bytes, width: int, height: int, quality: int) -> bytes:
    """A small copy of a JPEG picture."""
    with Image.open(io.BytesIO(jpeg)) as image:
        return encode_jpeg(image.resize((width, height), Image.Resampling.LANCZOS), quality)
