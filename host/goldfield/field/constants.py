"""Physical constants of the field models."""

from scipy.constants import mu_0

MU0_OVER_4PI: float = mu_0 / (4.0 * 3.141592653589793)
"""Magnetic constant over 4 pi, T m/A (CODATA, as SciPy gives it; magpylib uses the same)."""
