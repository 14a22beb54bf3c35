"""Positions and attitudes in the fields of dual-axis beacons: the paper's three algorithms, and the exact fit."""

from hil_sim.papers.zheng.methods.ellipse import locate_by_ellipse
from hil_sim.papers.zheng.methods.fingerprint import FingerprintMap

__all__ = ["FingerprintMap", "locate_by_ellipse"]
