"""Poses and numbers as JSON: records without NaN, one a line, as the commands print and the live page gets them."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from goldfield.types import Fields, FloatArray, Pose


def json_line(record: dict[str, Any]) -> str:
    """Return one line of JSON; a NaN that slipped through is a defect and raises ValueError."""
    return json.dumps(record, allow_nan=False)


def pose_record(pose: Pose) -> dict[str, Any]:
    """Return a pose under the keys of ``goldfield locate --json``; what is not known is None."""
    located = bool(np.isfinite(pose.position_m).all() and np.isfinite(pose.orientation_xyzw).all())
    return {
        "epoch": pose.epoch,
        "t_s": number(pose.time_s),
        "position_m": pose.position_m.tolist() if located else None,
        "orientation_xyzw": pose.orientation_xyzw.tolist() if located else None,
        "position_cov_m2": whole_array(pose.position_cov_m2) if located else None,
        "attitude_cov_rad2": whole_array(pose.attitude_cov_rad2) if located else None,
        "residual": number(pose.residual),
        "status": pose.status.value,
        "used": list(pose.used),
        "excluded": list(pose.excluded),
        "reason": pose.reason,
        "protection_m": number(pose.protection_m),
        "alternative": None if pose.alternative is None else _place(pose.alternative),
        "beacons": {name: number(residual) for name, residual in pose.residuals.items()},
    }


def _place(pose: Pose) -> dict[str, Any]:
    return {"position_m": pose.position_m.tolist(), "orientation_xyzw": pose.orientation_xyzw.tolist()}


def fields_record(fields: Fields, unix_s: float) -> dict[str, Any]:
    """Return the separated fields of a cycle for JSON, in the sensor's frame; None where nothing was measured."""
    return {
        "epoch": fields.epoch,
        "t_s": number(fields.time_s),
        "unix_s": number(unix_s),
        "fields": [
            {"beacon": beacon, "b_T": elements(field_T.tolist()), "sigma_T": number(sigma_T)}
            for beacon, field_T, sigma_T in zip(fields.beacons, fields.field_T, fields.sigma_T.tolist(), strict=True)
        ],
    }


def number(value: float) -> float | None:
    """Return a finite number or None."""
    return float(value) if math.isfinite(value) else None


def whole_array(values: FloatArray) -> Any:
    """Return an array as lists, or None if any element is not finite."""
    return values.tolist() if np.isfinite(values).all() else None


def elements(values: Iterable[float]) -> list[float | None]:
    """Return each finite element, None for the others: an axis that was not measured."""
    return [number(value) for value in values]
