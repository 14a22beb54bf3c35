"""Turns what is known of a cycle into an `Observation`: separated fields, or all samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from goldfield.access.moving import Cycle, Reduction, node_times, separation_weights
from goldfield.access.of_site import SiteAccess
from goldfield.access.waveform import site_templates
from goldfield.errors import UserError
from goldfield.field import FieldModel
from goldfield.locate import Locator
from goldfield.locate.sensor_axes import axes_of
from goldfield.locate.site_errors import errors_of
from goldfield.site import Site
from goldfield.track.deviations import Deviations
from goldfield.track.estimate import SEARCH_TOLERANCE, VAGUE, Belief, estimate
from goldfield.track.motion import Observation, State, standing
from goldfield.types import LEAST_SIGMA_T, Fields, FloatArray, Pose, Status, usable_components

EPOCH_NODES = 3
CYCLE_NODES = 7

AMBIENT_T = 5e-5
"""Size of the earth's field: a turning sensor sweeps this much across its axes."""

START_MODEL_ERROR = 0.03
"""Relative error granted to the fields of a cycle whose motion is not yet known."""

START_EVALUATIONS = 40

REMEMBERED = 64
"""Sets of beacons whose matrices are kept."""


class Timed(Protocol):
    """What belongs to one cycle."""

    @property
    def epoch(self) -> int:
        """Number of the cycle."""
        ...

    @property
    def time_s(self) -> float:
        """Middle of the cycle."""
        ...

    @property
    def beacons(self) -> tuple[str, ...]:
        """Ids of the beacons that may be in it."""
        ...


@dataclass(frozen=True, eq=False)
class CycleData:
    """A cycle as the sensor sampled it.

    Attributes
    ----------
    epoch : int
    time_s : float
        Middle of the cycle.
    beacons : tuple of str
        All of the site.
    data_T : ndarray, shape (N, 3)
        One row a chip, sensor's frame; NaN on an axis that was not measured.
    """

    epoch: int
    time_s: float
    beacons: tuple[str, ...]
    data_T: FloatArray


T = TypeVar("T", bound=Timed)
T_contra = TypeVar("T_contra", bound=Timed, contravariant=True)


class Observer(Protocol[T_contra]):
    """Makes observations of one kind of data."""

    def start(self, data: T_contra) -> tuple[Pose, State | None]:
        """Locate with no prior; the state to start a track from, if there is one."""
        ...

    def observation(
        self, data: T_contra, rate_rad_s: float, without: Sequence[str] = ()
    ) -> tuple[Observation, tuple[str, ...]]:
        """Return what the data tell and the beacons in it.

        ``rate_rad_s`` is the root mean square of the turn rate as far as it is known; ``without`` lists beacons of
        which nothing is to be believed.
        """
        ...


@dataclass(frozen=True, eq=False)
class _Separation:
    """What separated fields of one set of beacons see; ``sweep``, shape (n,), s: their error by a ramp of 1 T/s.

    ``deviations`` are those of the beacons; None if the site is exact.
    """

    model: FieldModel
    seen: FloatArray
    sweep: FloatArray
    deviations: Deviations | None


def check_levers(site: Site) -> None:
    """Check that the sensor's axes read at one point, as what the data of a moving sensor tell is modelled.

    Raises
    ------
    UserError
        If they do not.
    """
    if site.sensor.lever_m is not None:
        raise UserError(
            f"site {site.name}: a track takes all axes of the sensor to be at one point, but [sensor] has lever_m: "
            "leave out --track, or lever_m if it is small"
        )


class EpochObserver:
    """Separated fields as observations: averages over the cycle, weighted by the drives, with all that this implies.

    Fields separated on [drives, 1] also contain a part of the ambient field's ramp while the sensor turns. Its shape
    over the beacons is known, its size is not: it is left out of what an observation tells by a variance along that
    shape, as large as the fields say (``sweep_T_s``), else as the turn rate allows.

    Parameters
    ----------
    site : Site
    drift : int
        Order of the ambient field's polynomial that the fields were separated with: 0 for [codes, 1], which is what
        sensors send, 2 for `DriftSeparator`.
    """

    def __init__(self, site: Site, drift: int = 0) -> None:
        self._site, self._drift = site, drift
        self._row = {beacon.id: row for row, beacon in enumerate(site.beacons)}
        self._model = FieldModel(site.beacons)
        self._locator = Locator(site)
        self._axes = axes_of(site.sensor)
        self._unknown_T = np.array([beacon.unknown_T for beacon in site.beacons])
        self._times = node_times(EPOCH_NODES)
        self._templates = site_templates(site)
        self._separations: dict[bytes, _Separation] = {}

    @cached_property
    def _access_weights(self) -> FloatArray:
        return SiteAccess(self._site).weights

    def start(self, data: Fields) -> tuple[Pose, State | None]:
        """See `Observer.start`."""
        return _start(self._locator.locate(data))

    def observation(
        self, data: Fields, rate_rad_s: float, without: Sequence[str] = ()
    ) -> tuple[Observation, tuple[str, ...]]:
        """See `Observer.observation`; beacons that the site has not are left out, and fields without a usable sigma."""
        usable = usable_components(data.field_T, data.sigma_T)
        taken = [i for i, name in enumerate(data.beacons) if usable[i].any() and name in self._row]
        taken.sort(key=lambda i: self._row[data.beacons[i]])
        if not taken:
            nothing = np.zeros((3, 0, EPOCH_NODES * (len(self._row) + 1)))
            return Observation(self._model, self._site.cycle_s * self._times, nothing, nothing[..., 0], 0), ()
        names = [data.beacons[i] for i in taken]
        separation = self._separation(np.array([self._row[name] for name in names], dtype=np.intp))
        field = data.field_T[taken]
        field = np.where(usable[taken], field, np.nan)
        sigma = np.maximum(data.sigma_T[taken, None], LEAST_SIGMA_T)
        if self._axes is not None:
            field, sigma = self._axes.components(field), sigma * self._axes.noise_of_each
        sigma = np.hypot(sigma, self._unknown_T[[self._row[name] for name in names], None])
        measured = np.isfinite(field)
        measured[[name in without for name in names]] = False
        ramp = (AMBIENT_T * rate_rad_s if data.sweep_T_s is None else data.sweep_T_s) * separation.sweep
        # Whitening of the covariance diag(sigma^2) + ramp ramp': with c = ramp/sigma the inverse root is
        # (I - c c' (1 - 1/sqrt(1 + c'c))/c'c) diag(1/sigma), for each axis over what was measured on it.
        weight = np.where(measured, 1.0 / sigma, 0.0).T
        shape = weight * ramp
        size2 = np.maximum((shape * shape).sum(axis=1), 1e-12)
        shrink = ((1.0 - 1.0 / np.sqrt(1.0 + size2)) / size2)[:, None] * shape
        seen = weight[:, :, None] * separation.seen
        seen -= shrink[:, :, None] * (shape[:, None] @ seen)
        values = weight * np.where(measured, field, 0.0).T
        values -= shrink * (shape * values).sum(axis=1, keepdims=True)
        heard = tuple(name for name, axes in zip(names, measured, strict=True) if axes.any())
        times = self._site.cycle_s * self._times
        count = int(measured.sum())
        return Observation(separation.model, times, seen, values, count, separation.deviations), heard

    def _separation(self, rows: NDArray[np.intp]) -> _Separation:
        key = rows.tobytes()
        if key not in self._separations:
            if len(self._separations) >= REMEMBERED:
                self._separations.clear()
            beacons = [self._site.beacons[row] for row in rows]
            codes, templates = [beacon.code for beacon in beacons], self._templates[:, rows]
            if min(codes) >= 0:
                weights = separation_weights(self._site.degree, codes, self._drift, templates)[:-1]
            else:  # told apart by other means than one plain code each
                weights = self._access_weights[rows]
            seen = Cycle(self._site.degree, (), EPOCH_NODES, templates).seen(weights)
            sweep = self._site.cycle_s * seen[:, -EPOCH_NODES:] @ self._times
            seen[:, -EPOCH_NODES:] = 0.0
            self._separations[key] = _Separation(FieldModel(beacons), seen, sweep, _deviations(self._site, rows))
        return self._separations[key]


class CycleObserver:
    """All samples of a cycle as observations that tell velocity and turn rate as well.

    Parameters
    ----------
    site : Site
    """

    def __init__(self, site: Site) -> None:
        check_levers(site)
        self._model = FieldModel(site.beacons)
        self._row = {beacon.id: row for row, beacon in enumerate(site.beacons)}
        self._locator = Locator(site)
        self._axes = axes_of(site.sensor)
        self._deviations = _deviations(site, np.arange(len(site.beacons)))
        cycle = Cycle(site.degree, site.codes, CYCLE_NODES, site_templates(site))
        self._reduction = Reduction(cycle, site.sensor.noise_T)
        self._times = site.cycle_s * cycle.times
        # All fields as parabolas: the strong, quickly changing field of a near coil then leaks into no other.
        powers = (2.0 * cycle.times[:, None]) ** np.arange(3)
        parabolas = np.kron(np.eye(len(site.beacons) + 1), powers)
        fit = np.linalg.pinv(self._reduction.seen @ parabolas)
        self._parabola = np.concatenate([fit[::3], fit[1::3] * 2.0 / site.cycle_s])
        self._parabola_sigma = np.sqrt((self._parabola**2).sum(axis=1))

    def start(self, data: CycleData) -> tuple[Pose, State | None]:
        """See `Observer.start`: from the fields at mid-cycle; then the motion from their slopes, loosely weighted."""
        numbers = self._parabola @ self._reduction.numbers(data.data_T)
        heard = np.isfinite(numbers).all(axis=0)
        size = np.linalg.norm(np.where(heard, numbers, 0.0), axis=1)
        sigma = np.hypot(self._parabola_sigma, START_MODEL_ERROR * size)
        count = len(self._row)
        fields = Fields(data.epoch, data.time_s, tuple(self._row), numbers[:count], sigma[:count])
        pose, state = _start(self._locator.locate(fields))
        if state is None:
            return pose, None
        ambient = self._components(numbers[count])
        ambient = state.rotation @ np.where(np.isfinite(ambient), ambient, 0.0)
        near = State(state.position_m, state.rotation, state.velocity_m_s, state.rate_rad_s, ambient)
        loose = self._observation((numbers / sigma[:, None]).T, self._parabola @ self._reduction.seen / sigma[:, None])
        return pose, estimate(Belief(near, np.diag(VAGUE)), loose, START_EVALUATIONS, SEARCH_TOLERANCE).belief.state

    def observation(
        self, data: CycleData, rate_rad_s: float, without: Sequence[str] = ()
    ) -> tuple[Observation, tuple[str, ...]]:
        """See `Observer.observation`; the turn rate is seen, not needed."""
        numbers = self._reduction.numbers(data.data_T)
        seen = self._reduction.seen
        if without:
            columns = [self._row[name] * CYCLE_NODES + node for name in without for node in range(CYCLE_NODES)]
            # What is orthogonal to all that these beacons could add
            rest = np.linalg.qr(seen[:, columns], mode="complete")[0][:, len(columns) :].T
            numbers, seen = rest @ numbers, rest @ seen
        observation = self._observation(numbers.T, seen)
        return observation, tuple(name for name in self._row if name not in without and observation.count)

    def _observation(self, numbers: FloatArray, seen: FloatArray) -> Observation:
        """Return numbers of the axes, shape (3, r), as an observation; an axis with a NaN is not measured."""
        numbers, weight = self._components(numbers.T).T, np.ones(3)
        if self._axes is not None:  # the noise of components is no longer 1, as that of readings was
            weight = 1.0 / self._axes.noise_of_each
        measured = np.asarray(np.isfinite(numbers).all(axis=1))
        return Observation(
            self._model,
            self._times,
            np.where(measured[:, None, None], weight[:, None, None] * seen, 0.0),
            np.where(measured[:, None], weight[:, None] * numbers, 0.0),
            int(measured.sum()) * len(seen),
            self._deviations,
        )

    def _components(self, readings: FloatArray) -> FloatArray:
        """Return components in the sensor's frame, of readings, both of shape (..., 3)."""
        return readings if self._axes is None else self._axes.components(readings)


def _deviations(site: Site, rows: NDArray[np.intp]) -> Deviations | None:
    errors = errors_of(site.beacons, site.sensor)
    return None if errors is None else Deviations(errors.subset(rows), rows, len(site.beacons))


def _start(pose: Pose) -> tuple[Pose, State | None]:
    usable = pose.status not in (Status.FAILED, Status.AMBIGUOUS)
    return pose, standing(pose.position_m, pose.orientation_xyzw) if usable else None
