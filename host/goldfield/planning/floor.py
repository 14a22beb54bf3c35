"""A floor plan beneath the maps: an image and where it lies in the site's frame."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goldfield.errors import UserError, option
from goldfield.files.inputs import read_bounded

LARGEST_FILE = 20_000_000
"""Bytes of an image; a page holds it whole."""

KINDS = {b"\x89PNG\r\n\x1a\n": "image/png", b"\xff\xd8\xff": "image/jpeg"}
"""What the files of each kind of image begin with."""


@dataclass(frozen=True, eq=False)
class Floor:
    """A floor plan.

    Attributes
    ----------
    data : bytes
        The image file.
    kind : str
        Its media type.
    extent_m : tuple of float
        x0, y0, x1, y1 of its lower left and upper right corners.
    """

    data: bytes
    kind: str
    extent_m: tuple[float, float, float, float]

    def pixels(self) -> NDArray[Any]:
        """Return the image, shape (rows, columns, channels), the upper row first."""
        import matplotlib.image

        return np.asarray(matplotlib.image.imread(io.BytesIO(self.data), format=self.kind.removeprefix("image/")))


def load(path: str | Path, extent_m: Sequence[float]) -> Floor:
    """Read a floor plan.

    Raises
    ------
    UserError
        If it cannot be read, is neither PNG nor JPEG, or the corners are the wrong way round.
    """
    data = read_bounded(path, "floor plan", LARGEST_FILE)
    kind = next((kind for begin, kind in KINDS.items() if data.startswith(begin)), None)
    if kind is None:
        raise UserError(f"{path}: is neither PNG nor JPEG: give the floor plan as one of them")
    x0, y0, x1, y1 = extent_m
    if not (x1 > x0 and y1 > y0):
        raise UserError(f"{option('floor_extent')} must be x0 y0 x1 y1, the lower left corner first")
    floor = Floor(data, kind, (x0, y0, x1, y1))
    try:
        floor.pixels()
    except (OSError, ValueError, SyntaxError) as error:
        raise UserError(f"{path}: the floor plan cannot be read: {' '.join(str(error).split())[:200]}") from error
    return floor
