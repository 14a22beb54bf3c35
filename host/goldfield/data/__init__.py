"""Measured data from the literature and example sites, shipped with the package; each file says where it is from."""
