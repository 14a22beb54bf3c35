"""Calibration: what a sensor and coils are really like, from recordings made for it (`sensor`, `coils`)."""
