"""Fields of coils with gradients: dipole, exact circular loop, any wire as a polyline; see `FieldModel`."""

from goldfield.field.model import FieldModel

__all__ = ["FieldModel"]
