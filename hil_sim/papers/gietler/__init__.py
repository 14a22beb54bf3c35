"""Gietler, Ammari and Zangl: moving emitters tracked by a fixed sensor, beside conductors."""
