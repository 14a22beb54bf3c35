"""The pipeline: what a sensor on a link sends becomes poses."""
