"""What the host knows of a room before the first sample, and the site file that tells it."""

from goldfield.site.model import Beacon, HalfSpace, SensorSite, Site, Survey, area_vector
from goldfield.site.reading import load

__all__ = ["Beacon", "HalfSpace", "SensorSite", "Site", "Survey", "area_vector", "load"]
