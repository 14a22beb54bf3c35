"""Position and attitude from the fields of one epoch, with no prior; `locate` is the door."""

from goldfield.locate.locator import Locator, locate

__all__ = ["Locator", "locate"]
