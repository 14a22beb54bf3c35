"""The NPZ file of a plan: everything as arrays, for programs of one's own."""

from __future__ import annotations

import io

import numpy as np

from goldfield.planning.maps import Maps


def npz(maps: Maps) -> bytes:
    """Return the bytes of an NPZ file with the arrays of `Maps.arrays`; the same maps give the same bytes."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **maps.arrays())
    return buffer.getvalue()
