"""Fields of coils with their gradients: the dipole, the exact circular loop, any wire as a polyline; see `FieldModel`."""

from goldfield.field.model import FieldModel

__all__ = ["FieldModel"]
