"""Physical constants of the field models."""

from goldfield.site.constants import MU_0

MU0_OVER_4PI: float = MU_0 / (4.0 * 3.141592653589793)
"""Magnetic constant over 4 pi, T m/A."""
