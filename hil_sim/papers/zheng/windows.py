"""Windows of samples of dual-axis beacons, separated: from a table of times and fields, or the raw chips of a board."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from goldfield.access import SiteAccess
from goldfield.cli import chips_file
from goldfield.cli.chips_file import PLACE, place_of
from goldfield.errors import UserError
from goldfield.files.csv_table import Row, read_groups
from goldfield.site.dual_axis import DualAxisSite
from goldfield.site.rotating import RotatingSite
from goldfield.types import FloatArray
from hil_sim.papers.zheng.columns import SAMPLES
from hil_sim.papers.zheng.methods.separation import RotatingSeparation, RotatingSeparator, separate_by_fft

EVEN = 1e-4
"""Steps of time that differ by less than this part of themselves are even: what is left by printing the times."""


@dataclass(frozen=True, eq=False)
class Window:
    """The separated fields of one standing place.

    Attributes
    ----------
    window : int
        Number of the window in the table.
    field_T : ndarray, shape (1, n, 2, 3)
        Bc and Bs of each beacon; NaN where the samples that are left do not tell.
    sigma_T : ndarray, shape (n,)
        Standard deviation of each component of a beacon's field.
    place_m : ndarray, shape (3,), or None
        Place where the table says that the sensor stood.
    """

    window: int
    field_T: FloatArray
    sigma_T: FloatArray
    place_m: FloatArray | None


def read_windows(site: RotatingSite | DualAxisSite, path: str, separation: str = "least-squares") -> Iterator[Window]:
    """Yield the separated windows of a table of samples.

    Raises
    ------
    UserError
        With file, line and column of whatever is wrong.
    """
    if isinstance(site, DualAxisSite):
        yield from _cycles(site, path, separation)
        return
    for rows in read_groups(path, "window", SAMPLES, PLACE):
        yield _window(site, rows, separation)


def _cycles(dual: DualAxisSite, path: str, method: str) -> Iterator[Window]:
    """Yield a window for every cycle of raw chips; sample t of a cycle was taken in chip t of all beacons."""
    site = dual.site
    if method == "fft" and any(beacon.drive.tau_s for beacon in site.beacons):
        raise UserError("an FFT knows nothing of the coils' rise (tau_s of the site): separate by least squares")
    access = SiteAccess(site)
    for number, cycle in enumerate(chips_file.read_cycles(site, path)):
        if method == "fft":
            if np.isnan(cycle.samples_T).any():
                raise UserError(f"{path}: cycle {number} has chips that are missing: separate by least squares")
            rate_Hz = 1.0 / site.chip_period_s
            whole = separate_by_fft(cycle.samples_T[None], rate_Hz, dual.rotating.frequency_Hz, site.sensor.noise_T)
            sine_first = np.array([site.beacons[row].drive.wave == "sine" for row in dual.rows[:, 0]])
            field = np.where(sine_first[:, None, None], whole.field_T[:, :, ::-1], whole.field_T)
            yield Window(number, field, whole.sigma_T, cycle.place_m)
        else:
            separation = access.from_samples(cycle.samples_T)
            sigma = separation.sigma_T[dual.rows].max(axis=1)
            yield Window(number, separation.field_T[dual.rows][None], sigma, cycle.place_m)


def _window(site: RotatingSite, rows: list[Row], method: str) -> Window:
    first = rows[0]
    times = np.array([row.number("t_s") for row in rows])
    samples = np.array([[row.number(column) for column in SAMPLES[2:]] for row in rows])
    try:
        if method == "fft":
            separation = _by_fft(site, times, samples)
        else:
            separation = RotatingSeparator(site.frequency_Hz, times, site.noise_T).separate(samples[None])
    except UserError as error:
        raise first.error("window", f"{first.text('window')}: {error}") from error
    place = place_of(first)
    if place is not None:
        for row in rows:
            for column, value in zip(PLACE, place, strict=True):
                if row.number(column) != value:
                    raise row.error(column, f"differs from the {value:g} of the window's first row: one place a window")
    return Window(first.whole("window"), separation.field_T, separation.sigma_T, place)


def _by_fft(site: RotatingSite, time_s: FloatArray, samples_T: FloatArray) -> RotatingSeparation:
    steps = np.diff(time_s)
    if not len(steps) or steps.min() <= 0.0 or np.ptp(steps) > EVEN * steps.mean():
        raise UserError("an FFT needs samples at even distances in time: separate by least squares, which takes any")
    rate_Hz = (len(time_s) - 1) / (time_s[-1] - time_s[0])
    return separate_by_fft(samples_T[None], rate_Hz, site.frequency_Hz, site.noise_T, time_s[0])
