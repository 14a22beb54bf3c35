"""Position and attitude from the fields of one epoch, with no prior; `locate` is the door.

The package is callable as its function `locate` is: ``goldfield.locate`` is a public function, and the same name is
bound to this package as soon as anything imports it.
"""

import sys
from collections.abc import Callable
from importlib import import_module
from types import ModuleType

from goldfield.locate.locator import Locator, locate
from goldfield.site import Site
from goldfield.types import Fields, Pose

__all__ = ["Locator", "locate"]


class _CallablePackage(ModuleType):
    def __call__(self, site: Site, fields: Fields) -> Pose:
        return locate(site, fields)

    def __reduce__(self) -> tuple[Callable[[str], ModuleType], tuple[str]]:
        """Let other processes have ``goldfield.locate`` as they have any other function: by its name."""
        return import_module, (self.__name__,)


sys.modules[__name__].__class__ = _CallablePackage
