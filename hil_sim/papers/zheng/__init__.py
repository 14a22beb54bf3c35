"""Zheng et al. 2022: dual-axis (rotating-field) beacons, located by fingerprints and by their fields' ellipses."""
