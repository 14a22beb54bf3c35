"""What a recording tells of the run that made it, and with what the run can be made again."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import platform
import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from goldfield.files.inputs import STREAM
from goldfield.sensor.options import Method, Options
from goldfield.site import Site
from goldfield_protocol.messages import protocol_hash

ABOUT = "goldfield"
"""Name of the metadata."""
SITE_FILE = "site.toml"
"""Name of the attachment that is the site file."""


@dataclass(frozen=True)
class About:
    """What a recording tells of the run.

    Attributes
    ----------
    source : str
        The link or the log, as "port /dev/ttyUSB0".
    options : Options
    site : Site
    site_file : str
        Path of the site file, which is attached if it can be read again.
    live : bool
        Whether poses are made as messages arrive; else each was made, as far as the recording tells, as they came.
    """

    source: str
    options: Options
    site: Site
    site_file: str
    live: bool

    def metadata(self, site_file: bytes | None) -> dict[str, str]:
        """Return versions, source and options, as text."""
        told = dataclasses.asdict(dataclasses.replace(self.options, key=None))  # a key is nobody's to read
        options = {name: value for name, value in told.items() if value is not None}
        return {
            "goldfield": version("goldfield"),
            "protocol": f"{protocol_hash():#010x}",
            "foxglove-sdk": version("foxglove-sdk"),
            "python": platform.python_version(),
            "machine": f"{platform.system()} {platform.machine()}",
            "source": self.source,
            "site": self.site.name,
            "site_sha256": "" if site_file is None else hashlib.sha256(site_file).hexdigest(),
            "alert_limit_m": json.dumps(self.site.alert_limit_m if math.isfinite(self.site.alert_limit_m) else None),
            "options": json.dumps(options),
            "begun": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        }

    def site_bytes(self) -> bytes | None:
        """Return the site file; None if it cannot be read a second time."""
        path = Path(self.site_file)
        try:
            return path.read_bytes() if self.site_file != STREAM and path.is_file() else None
        except OSError:
            return None


def options_of(metadata: Mapping[str, str]) -> Options:
    """Return the options with which a recorded run made its poses; what it does not tell is as by default."""
    told = json.loads(metadata.get("options", "{}"))
    names = ("node", "channel", "rate_hz", "lag_s", "strongest")
    return Options(Method(told.get("method", Method.EACH)), **{name: told[name] for name in names if name in told})
