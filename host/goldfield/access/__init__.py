"""Multiple access: which part of the sum field belongs to which beacon."""

from goldfield.access.cdma import Separation, Separator, plain_correlation
from goldfield.access.gold import code_matrix, sequence
from goldfield.access.linear import Access, TemplateAccess
from goldfield.access.of_site import SiteAccess

__all__ = [
    "Access",
    "Separation",
    "Separator",
    "SiteAccess",
    "TemplateAccess",
    "code_matrix",
    "plain_correlation",
    "sequence",
]
