"""How fast goldfield is beside what one would use in its place: ``make bench`` (README.md)."""
