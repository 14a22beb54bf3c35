"""Poses and fields of a run as tables of columns, written as CSV, NPZ or Parquet."""

from __future__ import annotations

import csv
import io
import math
from array import array
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goldfield.errors import UserError
from goldfield.foxglove.topics import FIELDS, LINE
from goldfield.recording import line_checks
from goldfield.recording.line_checks import MATRICES
from goldfield.recording.runs import Item
from goldfield.types import FloatArray

AXES = "xyz"
NUMBERS = ("epoch", *line_checks.NUMBERS)
"""Keys of a line that are one number each; NaN where it is not known."""
TEXTS = ("status", *line_checks.TEXTS)
"""Keys that are text; ids of beacons are joined by commas."""

Column = NDArray[Any]
Json = Mapping[str, Any]


class PoseTable:
    """The lines of a run, column by column.

    Attributes
    ----------
    beacons : list of str
        Ids of the beacons, in the order in which they were met.
    """

    def __init__(self) -> None:
        self.beacons: list[str] = []
        self._numbers = {name: array("d") for name in (*NUMBERS, *MATRICES, "arrived_s")}
        self._texts: dict[str, list[str]] = {name: [] for name in TEXTS}
        self._residuals: dict[str, array[float]] = {}
        self._count = 0

    def __len__(self) -> int:
        """Return the number of poses."""
        return self._count

    def add(self, item: Item) -> None:
        """Take the next line."""
        record = item.record
        for name in NUMBERS:
            self._numbers[name].append(_number(record.get(name)))
        self._numbers["arrived_s"].append(item.arrived_s)
        for name, shape in MATRICES.items():
            value = record.get(name)
            size = math.prod(shape)
            self._numbers[name].extend([math.nan] * size if value is None else np.ravel(value).tolist())
        for name in TEXTS:
            value = record.get(name) or ""
            self._texts[name].append(value if isinstance(value, str) else ",".join(value))
        for beacon, residual in record.get("beacons", {}).items():
            if beacon not in self._residuals:
                self.beacons.append(beacon)
                self._residuals[beacon] = array("d", [math.nan] * self._count)
            self._residuals[beacon].append(_number(residual))
        self._count += 1
        for column in self._residuals.values():
            column.extend([math.nan] * (self._count - len(column)))

    def columns(self) -> dict[str, Column]:
        """Return the columns by name, one row a pose: ``residuals`` has one column a beacon, all else as in a line."""
        found: dict[str, Column] = {name: self._column(name) for name in (*NUMBERS, "arrived_s")}
        found |= {name: self._column(name).reshape(-1, *shape) for name, shape in MATRICES.items()}
        found |= {name: np.array(values, dtype=np.str_) for name, values in self._texts.items()}
        found["residuals"] = np.array([self._residuals[name] for name in self.beacons]).reshape(-1, len(self)).T
        return found

    def flat(self) -> dict[str, Column]:
        """Return columns of one value a row each, as a table has them."""
        columns = self.columns()
        found: dict[str, Column] = {name: columns[name] for name in ("epoch", "t_s", "unix_s", "arrived_s")}
        found |= {f"{axis}_m": columns["position_m"][:, i] for i, axis in enumerate(AXES)}
        found |= {f"q{axis}": columns["orientation_xyzw"][:, i] for i, axis in enumerate("xyzw")}
        for name in ("status", "residual", "protection_m"):
            found[name] = columns[name]
        for name, key in (("cov", "position_cov_m2"), ("attitude_cov", "attitude_cov_rad2")):
            unit = key.rpartition("_")[2]
            for i, j in zip(*np.triu_indices(3), strict=True):
                found[f"{name}_{AXES[i]}{AXES[j]}_{unit}"] = columns[key][:, i, j]
        for name in ("latency_s", "lost", "chips", "saturated", "locked", "used", "excluded", "reason"):
            found[name] = columns[name]
        return found | {f"residual_{name}": columns["residuals"][:, i] for i, name in enumerate(self.beacons)}

    def _column(self, name: str) -> FloatArray:
        return np.array(self._numbers[name], dtype=np.float64)


class FieldTable:
    """The separated fields of a run, one row a beacon of a cycle."""

    def __init__(self) -> None:
        self._numbers = array("d")
        self._beacons: list[str] = []

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self._beacons)

    def add(self, item: Item) -> None:
        """Take the fields of the next cycle."""
        for field in item.record["fields"]:
            numbers = (item.record["epoch"], item.record["t_s"], *field["b_T"], field["sigma_T"])
            self._numbers.extend(_number(value) for value in numbers)
            self._beacons.append(field["beacon"])

    def columns(self) -> dict[str, Column]:
        """Return the columns of a table that ``goldfield locate`` reads."""
        rows = np.array(self._numbers).reshape(-1, 6)
        found: dict[str, Column] = {"epoch": rows[:, 0], "t_s": rows[:, 1], "beacon": np.array(self._beacons, np.str_)}
        return found | {name: rows[:, 2 + i] for i, name in enumerate(("bx_T", "by_T", "bz_T", "sigma_T"))}


def tables_of(items: Iterable[Item]) -> tuple[PoseTable, FieldTable]:
    """Return the poses and the fields of a run."""
    poses, fields = PoseTable(), FieldTable()
    for item in items:
        if item.topic == LINE:
            poses.add(item)
        elif item.topic == FIELDS:
            fields.add(item)
    return poses, fields


def csv_bytes(columns: Mapping[str, Column]) -> bytes:
    """Return a table as CSV: numbers with every digit, an empty cell for what is not known."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*([_cell(value) for value in column.tolist()] for column in columns.values()), strict=True))
    return text.getvalue().encode()


def npz_bytes(columns: Mapping[str, Column]) -> bytes:
    """Return arrays as NumPy's archive."""
    file = io.BytesIO()
    arrays: dict[str, Any] = dict(columns)
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def parquet_bytes(columns: Mapping[str, Column]) -> bytes:
    """Return a table as Parquet; what is not known is null.

    Raises
    ------
    UserError
        If the package that writes it is not installed.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ModuleNotFoundError as error:
        raise UserError(
            "--to parquet needs the package pyarrow: install it with pip install 'goldfield[parquet]', or give --to npz"
        ) from error
    table = pyarrow.table({name: pyarrow.array(column, from_pandas=True) for name, column in columns.items()})
    file = io.BytesIO()
    parquet.write_table(table, file)
    return file.getvalue()


WRITERS: dict[str, Callable[[Mapping[str, Column]], bytes]] = {
    "csv": csv_bytes,
    "npz": npz_bytes,
    "parquet": parquet_bytes,
}
"""What makes a file of each format."""


def _number(value: float | bool | None) -> float:
    return math.nan if value is None else float(value)


def _cell(value: float | str) -> str:
    if isinstance(value, str):
        return value
    if math.isnan(value):
        return ""
    return str(int(value)) if value.is_integer() and abs(value) < 2**53 else repr(value)
