"""Multiple access: which part of the sum field belongs to which beacon."""

from goldfield.access.cdma import Separation, Separator, plain_correlation
from goldfield.access.gold import code_matrix, sequence

__all__ = ["Separation", "Separator", "code_matrix", "plain_correlation", "sequence"]
