"""Physical constants."""

MU_0: float = 1.25663706127e-6
"""Magnetic constant, T m/A (CODATA 2022; SciPy, which takes long to import, and magpylib have the same)."""
