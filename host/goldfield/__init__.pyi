from goldfield.errors import SystemFailure as SystemFailure
from goldfield.errors import UserError as UserError
from goldfield.locate import Locator as Locator
from goldfield.locate import locate as locate
from goldfield.sensor.fields_table import read_fields as read_fields
from goldfield.sensor.opening import connect as connect
from goldfield.sensor.opening import open_log as open_log
from goldfield.sensor.pipeline import Sensor as Sensor
from goldfield.site import Site as Site
from goldfield.site import load as load_site
from goldfield.track import Tracker as Tracker
from goldfield.types import Fields as Fields
from goldfield.types import Pose as Pose
from goldfield.types import Status as Status

__all__ = [
    "Fields",
    "Locator",
    "Pose",
    "Sensor",
    "Site",
    "Status",
    "SystemFailure",
    "Tracker",
    "UserError",
    "__version__",
    "connect",
    "load_site",
    "locate",
    "open_log",
    "read_fields",
]

__version__: str
