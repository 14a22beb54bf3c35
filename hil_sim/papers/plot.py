"""Pictures of experiments, as PNG or whatever else the file's name ends in; they need matplotlib."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from goldfield.errors import SystemFailure, UserError
from goldfield.files.outputs import write_file
from goldfield.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def panels(count: int, title: str, rows: int = 1) -> tuple[Figure, list[Axes]]:
    """Return a figure with some panels side by side, in one row or several.

    Raises
    ------
    SystemFailure
        If matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure as New
    except ImportError as error:
        raise SystemFailure('pictures need matplotlib: install it with pip install "goldfield[plot]"') from error
    figure = New(figsize=(6.0 * count, 4.5) if rows == 1 else (4.0 * count, 2.5 * rows), layout="constrained")
    figure.suptitle(title)
    return figure, [figure.add_subplot(rows, count, place + 1) for place in range(rows * count)]


def cumulative(axes: Axes, errors: Mapping[str, FloatArray], label: str) -> None:
    """Draw the share of errors below each size, one curve a name; what is not finite counts as never reached."""
    for name, error in errors.items():
        axes.step(
            np.sort(np.where(np.isfinite(error), error, np.inf)), np.arange(1, len(error) + 1) / len(error), label=name
        )
    axes.set(xlabel=label, ylabel="share of the runs", xscale="log", ylim=(0.0, 1.0))
    _finish(axes)


def curves(axes: Axes, x: FloatArray, lines: Mapping[str, FloatArray], xlabel: str, ylabel: str) -> None:
    """Draw curves over one axis."""
    for name, y in lines.items():
        axes.plot(x, y, label=name, marker="." if len(x) < 50 else "", linewidth=1.0)
    axes.set(xlabel=xlabel, ylabel=ylabel)
    _finish(axes)


def save(figure: Figure, path: str) -> None:
    """Write a figure, whole or not at all; `actions.action` has checked that it may replace what is there.

    Raises
    ------
    UserError
        If the file cannot be made or its name ends in no known format.
    SystemFailure
        If it cannot be written.
    """
    picture = io.BytesIO()
    try:
        figure.savefig(picture, dpi=120, format=Path(path).suffix.removeprefix(".") or "png")
    except ValueError as error:
        raise UserError(f"{path}: the picture cannot be written: {error}: give a name that ends in .png") from error
    write_file(path, picture.getvalue(), "the picture", force=True)


def _finish(axes: Axes) -> None:
    axes.grid(alpha=0.3)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2, frameon=False, fontsize="small")
