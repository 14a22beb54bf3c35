"""The topics of goldfield in Foxglove, and the schema of each: its own kinds of message, ROS's frame of CAN, or JSON.

| topic | schema | what it is |
| --- | --- | --- |
| ``/tf`` | ``foxglove.FrameTransforms`` | the frame ``sensor`` in the frame ``map`` |
| ``/goldfield/pose`` | ``foxglove.PoseInFrame`` | each pose |
| ``/goldfield/pose_covariance`` | ``foxglove.Odometry`` | each pose with its covariance |
| ``/goldfield/scene`` | ``foxglove.SceneUpdate`` | coils, coloured by health; ellipsoid and protection of the pose |
| ``/goldfield/log`` | ``foxglove.Log`` | what is wrong, as sentences |
| ``/goldfield/line`` | JSON | each pose under the keys of ``goldfield run --json``, and its times |
| ``/goldfield/fields`` | JSON | the separated fields of each cycle |
| ``/goldfield/health`` | JSON | rates, and each beacon at the sensor, now and then |
| ``/goldfield/parameters`` | JSON | what each board said of itself, now and then |
| ``/goldfield/can`` | ``can_msgs/msg/Frame`` | each message as it came, in CDR |
"""

from __future__ import annotations

from typing import Any

TRANSFORMS = "/tf"
POSE = "/goldfield/pose"
COVARIANCE = "/goldfield/pose_covariance"
SCENE = "/goldfield/scene"
LOG = "/goldfield/log"
LINE = "/goldfield/line"
FIELDS = "/goldfield/fields"
HEALTH = "/goldfield/health"
PARAMETERS = "/goldfield/parameters"
CAN = "/goldfield/can"

Json = dict[str, Any]

NUMBER, TEXT, FLAG = {"type": ["number", "null"]}, {"type": ["string", "null"]}, {"type": ["boolean", "null"]}
NUMBERS, MATRIX = {"type": "array", "items": NUMBER}, {"type": "array", "items": {"type": "array", "items": NUMBER}}
TEXTS = {"type": "array", "items": {"type": "string"}}


def _object(title: str, properties: Json) -> Json:
    return {"title": title, "type": "object", "properties": properties}


JSON_SCHEMAS: dict[str, Json] = {
    LINE: _object(
        "goldfield.Line",
        {
            **{key: NUMBER for key in ("epoch", "t_s", "unix_s", "latency_s", "residual", "protection_m")},
            **{key: NUMBER for key in ("lost", "chips", "saturated")},
            **{key: NUMBERS for key in ("position_m", "orientation_xyzw")},
            **{key: MATRIX for key in ("position_cov_m2", "attitude_cov_rad2")},
            **{key: TEXTS for key in ("used", "excluded")},
            **{key: TEXT for key in ("status", "reason")},
            "locked": FLAG,
            "alternative": {"type": ["object", "null"]},
            "beacons": {"type": "object"},
        },
    ),
    FIELDS: _object(
        "goldfield.Fields",
        {
            "epoch": NUMBER,
            "t_s": NUMBER,
            "unix_s": NUMBER,
            "fields": {
                "type": "array",
                "items": _object("goldfield.Field", {"beacon": TEXT, "b_T": NUMBERS, "sigma_T": NUMBER}),
            },
        },
    ),
    HEALTH: _object(
        "goldfield.Health",
        {
            **{
                key: NUMBER for key in ("t_s", "node", "cycles_per_s", "lost", "lost_in_all", "lost_chips", "saturated")
            },
            **{key: {"type": "object"} for key in ("statuses", "beacons", "counters")},
            "locked": FLAG,
            "reason": TEXT,
        },
    ),
    PARAMETERS: _object("goldfield.Parameters", {"nodes": {"type": "object"}}),
}
"""The JSON schema of each topic in JSON."""
