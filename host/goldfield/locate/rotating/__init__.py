"""Positions and attitudes in the fields of dual-axis beacons: the paper's three algorithms, and the exact fit."""

from goldfield.locate.rotating.ellipse import locate_by_ellipse
from goldfield.locate.rotating.fingerprint import FingerprintMap

__all__ = ["FingerprintMap", "locate_by_ellipse"]
