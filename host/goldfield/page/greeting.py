"""The first message to each browser: who speaks, and the site. It is there before what makes poses is loaded."""

from __future__ import annotations

from typing import Any

import numpy as np

from goldfield.site import Site
from goldfield.types import FloatArray
from goldfield.view.coil_wires import site_box, wire_of
from goldfield.view.records import json_line, number

PROTOCOL = 1
"""Version of the messages; the page says so if it was built for another."""


def hello(site: Site, name: str, *, live: bool) -> str:
    """Return the first message to a browser: who speaks, and the site.

    Parameters
    ----------
    site : Site
    name : str
        The link's name, or the recording's.
    live : bool
        Whether it is a sensor on a link, not a recording.
    """
    low, high = site_box(site)
    half = site.half_space
    return json_line(
        {
            "type": "hello",
            "protocol": PROTOCOL,
            "source": name,
            "live": live,
            "site": {
                "name": site.name,
                "cycle_s": site.cycle_s,
                "alert_limit_m": number(site.alert_limit_m),
                "box": {"low_m": _rounded(low), "high_m": _rounded(high)},
                "half_space": half and {"point_m": half.point_m.tolist(), "normal": half.normal.tolist()},
                "beacons": [
                    {
                        "id": beacon.id,
                        "code": beacon.code,
                        "position_m": _rounded(beacon.position_m),
                        "axis": _rounded(beacon.axis),
                        "wire_m": _rounded(wire_of(beacon)),
                    }
                    for beacon in site.beacons
                ],
            },
        }
    )


def _rounded(values: FloatArray) -> Any:
    return np.round(values, 5).tolist()
