"""Prigge and How (US patent 6,691,074): ways to tell beacons apart, compared on equal terms."""
