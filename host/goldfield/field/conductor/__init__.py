"""The secondary field of conducting, permeable bodies (Gietler, Ammari & Zangl).

`explicit` evaluates the explicit formula from integrals over small parts of the body, `interior` computes these
integrals for a body in the field of dipoles, `body` describes bodies.
"""

from goldfield.field.conductor.body import Body, Material, ball, cuboid
from goldfield.field.conductor.explicit import Parts
from goldfield.field.conductor.interior import Response, respond

__all__ = ["Body", "Material", "Parts", "Response", "ball", "cuboid", "respond"]
