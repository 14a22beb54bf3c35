"""The parameters of an adjustment: where each stands in the vector of all, what was known of it before, and its state.

The vector of what all epochs have in common holds six numbers a beacon, its place (m), the turn of its coil (rad, three
numbers about the site's axes of which the part along the coil's axis does nothing and is left out) as two turns across
the axis, and the logarithm of its current; then the sensor's six terms of gain and tilt, its offset, and its levers;
then metal (`goldfield.survey.metal`). Axis j of a sensor at p reads component j of

    y = (I + E) A R' B(p + R lever_j) + o,

with A as the site says and E an upper triangle: three gains on its diagonal and three tilts above it. A lower triangle
would be a turn of the sensor, which no measurement tells from one of its attitude: the body's frame is the one in which
the sensor's z axis points along z, and its y axis lies in the plane of y and z.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from goldfield.locate.rotations import orthonormal, turned
from goldfield.site import Beacon, Site
from goldfield.site.metal import COLUMNS, ROWS
from goldfield.survey.data import Free
from goldfield.survey.metal import MetalState, no_metal
from goldfield.types import FloatArray

BEACON = 6
"""Parameters of a beacon."""
TERMS = len(ROWS)
"""Terms of the sensor, the upper triangle of E: the gains, then the tilts xy, xz and yz."""
OFFSET, LEVER = slice(TERMS, TERMS + 3), slice(TERMS + 3, TERMS + 12)
"""Where the offset and the levers, one axis after another, stand among the parameters of the sensor."""
SENSOR = LEVER.stop
"""Parameters of the sensor: its terms, its offset and its levers."""
ANCHOR_TERMS, ANCHOR_LEVER = slice(3, 3 + TERMS), slice(3 + TERMS, 6 + TERMS)
"""Where terms and lever of an anchor's sensor stand among its own unknowns: behind its turn."""
ANCHOR = ANCHOR_LEVER.stop
"""Unknowns of an anchor's sensor: its turn, its terms and its lever."""

UNKNOWN_POSITION_M, UNKNOWN_AXIS_RAD, UNKNOWN_CURRENT = 0.3, 0.25, 0.1
"""Standard deviations of what is to be found and of which the site says nothing, or that it is exact."""
UNKNOWN_GAIN, UNKNOWN_TILT_RAD, UNKNOWN_OFFSET_T, UNKNOWN_LEVER_M = 0.05, 0.05, 1e-6, 0.03
"""The same for the sensor."""


@dataclass(frozen=True, eq=False)
class State:
    """Values of all parameters.

    Attributes
    ----------
    position_m, axis : ndarray, shape (n, 3)
        Beacons.
    log_current : ndarray, shape (n,)
        Logarithm of the current over that of the site.
    terms : ndarray, shape (6,)
        The sensor's E.
    offset_T : ndarray, shape (3,)
    sensor_m, rotation : ndarray, shapes (e, 3) and (e, 3, 3)
        Pose of the sensor in each epoch.
    anchor_rotation : ndarray, shape (a, 3, 3)
        Attitude of each anchor's sensor.
    metal : MetalState
    anchor_terms : ndarray, shape (a, 6)
        Its E.
    anchor_lever_m : ndarray, shape (a, 3)
        Where it reads, from the centre of its coil and in its own frame.
    lever_m : ndarray, shape (3, 3)
        Where each axis of the sensor reads, a row each, from its reference point and in its frame.
    """

    position_m: FloatArray
    axis: FloatArray
    log_current: FloatArray
    terms: FloatArray
    offset_T: FloatArray
    sensor_m: FloatArray
    rotation: FloatArray
    anchor_rotation: FloatArray
    metal: MetalState
    anchor_terms: FloatArray
    anchor_lever_m: FloatArray
    lever_m: FloatArray

    def matrix(self) -> FloatArray:
        """Return I + E, shape (3, 3)."""
        return matrix_of(self.terms)

    def moved(self, common: FloatArray, poses: FloatArray, anchors: FloatArray) -> State:
        """Return the state after a step.

        Parameters
        ----------
        common : ndarray, shape (g,)
        poses : ndarray, shape (e, 6)
            Shift and turn, in the site's frame.
        anchors : ndarray, shape (a, 12)
            Turn, in the site's frame, terms and lever.
        """
        count = len(self.position_m)
        of_beacons, of_sensor = common[: BEACON * count].reshape(count, BEACON), common[BEACON * count :][:SENSOR]
        turn = np.einsum("nji,nj->ni", across(self.axis), of_beacons[:, 3:5])
        axis = np.einsum("nij,nj->ni", turned(np.broadcast_to(np.eye(3), (count, 3, 3)).copy(), turn), self.axis)
        return State(
            self.position_m + of_beacons[:, :3],
            axis / np.linalg.norm(axis, axis=1, keepdims=True),
            self.log_current + of_beacons[:, 5],
            self.terms + of_sensor[:TERMS],
            self.offset_T + of_sensor[OFFSET],
            self.sensor_m + poses[:, :3],
            orthonormal(turned(self.rotation, poses[:, 3:])),
            orthonormal(turned(self.anchor_rotation, anchors[:, :3])),
            self.metal.moved(common[BEACON * count + SENSOR :]),
            self.anchor_terms + anchors[:, ANCHOR_TERMS],
            self.anchor_lever_m + anchors[:, ANCHOR_LEVER],
            self.lever_m + of_sensor[LEVER].reshape(3, 3),
        )

    def of_epochs(self, rows: NDArray[np.intp] | NDArray[np.bool_] | slice) -> State:
        """Return the state with some of the epochs."""
        return replace(self, sensor_m=self.sensor_m[rows], rotation=self.rotation[rows])


def matrix_of(terms: FloatArray) -> FloatArray:
    """Return I + E, shape (..., 3, 3), of terms, shape (..., 6)."""
    result = np.zeros((*terms.shape[:-1], 3, 3)) + np.eye(3)
    result[..., ROWS, COLUMNS] += terms
    return result


def across(axis: FloatArray) -> FloatArray:
    """Return two unit vectors across each axis, shape (n, 2, 3), that hardly change if it turns a little."""
    least = np.eye(3)[np.abs(axis).argmin(axis=1)]
    first = np.cross(axis, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(axis, first)], axis=1)


def turn_between(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the shortest rotation vectors, shape (n, 3), that take unit vectors to others."""
    normal = np.cross(before, after)
    sine = np.linalg.norm(normal, axis=1)
    angle = np.arctan2(sine, (before * after).sum(axis=1))
    return np.asarray(normal * (angle / np.maximum(sine, 1e-300))[:, None])


def start_of(site: Site, epochs: int, anchors: int, metal: MetalState | None = None) -> State:
    """Return the state that the site describes, with poses at the origin and metal as given."""
    return State(
        position_m=np.array([beacon.position_m for beacon in site.beacons]),
        axis=np.array([beacon.axis for beacon in site.beacons]),
        log_current=np.zeros(len(site.beacons)),
        terms=np.zeros(TERMS),
        offset_T=np.zeros(3),
        sensor_m=np.zeros((epochs, 3)),
        rotation=np.broadcast_to(np.eye(3), (epochs, 3, 3)).copy(),
        anchor_rotation=np.broadcast_to(np.eye(3), (anchors, 3, 3)).copy(),
        metal=no_metal(len(site.beacons)) if metal is None else metal,
        anchor_terms=np.zeros((anchors, TERMS)),
        anchor_lever_m=np.zeros((anchors, 3)),
        lever_m=np.zeros((3, 3)) if site.sensor.lever_m is None else site.sensor.lever_m,
    )


def beacons_of(site: Site, state: State) -> tuple[Beacon, ...]:
    """Return the beacons as a state has them: coils given by their wire are moved and turned as they are."""
    turn = turn_between(np.array([beacon.axis for beacon in site.beacons]), state.axis)
    rotation = turned(np.broadcast_to(np.eye(3), (len(turn), 3, 3)).copy(), turn)
    coils = tuple(
        replace(
            beacon,
            position_m=state.position_m[i],
            axis=state.axis[i],
            current_A=beacon.current_A * float(np.exp(state.log_current[i])),
            points_m=None
            if beacon.points_m is None
            else state.position_m[i] + (beacon.points_m - beacon.position_m) @ rotation[i].T,
        )
        for i, beacon in enumerate(site.beacons)
    )
    return coils if state.metal.is_none else state.metal.added_to(site.beacons, coils, state.metal.metal())


@dataclass(frozen=True, eq=False)
class Prior:
    """What was known before the survey.

    Attributes
    ----------
    free : ndarray of bool, shape (g,)
        The parameters that are estimated.
    sd : ndarray, shape (g,)
        Their standard deviations; infinite for what is not estimated.
    start : State
        The values that they are around.
    """

    free: NDArray[np.bool_]
    sd: FloatArray
    start: State

    def residual(self, state: State) -> FloatArray:
        """Return the deviations from what was known over their standard deviations, shape (g,)."""
        turn = np.einsum("nij,nj->ni", across(state.axis), turn_between(self.start.axis, state.axis))
        of_beacons = np.column_stack([state.position_m - self.start.position_m, turn, state.log_current])
        lever = (state.lever_m - self.start.lever_m).ravel()
        of_sensor = np.concatenate([state.terms, state.offset_T, lever])
        of_metal = state.metal.vector() - self.start.metal.vector()
        return np.concatenate([of_beacons.ravel(), of_sensor, of_metal]) / self.sd


def default_free(site: Site) -> frozenset[Free]:
    """Return the kinds that the site does not call exact; offset and levers are not among them."""
    surveys = [beacon.survey for beacon in site.beacons]
    uncertain = {
        Free.POSITION: any(survey.position_sd_m for survey in surveys),
        Free.AXIS: any(survey.axis_sd_rad for survey in surveys),
        Free.CURRENT: any(survey.current_sd for survey in surveys),
        Free.GAIN: bool(site.sensor.gain_sd),
        Free.TILT: bool(site.sensor.axis_sd_rad),
    }
    return frozenset(kind for kind, is_free in uncertain.items() if is_free)


def prior_of(site: Site, free: frozenset[Free], start: State, field_T: FloatArray) -> Prior:
    """Return what the site knows; ``field_T`` is as in `MetalState.sd`.

    A kind that is to be found and is called exact everywhere is taken as unknown.

    So is one that is merely assumed, since the file is silent: the assumption is that of a careful survey.
    """
    silent = " ".join(site.assumed)

    def of_kind(kind: Free, key: str, told: FloatArray, unknown: float) -> FloatArray:
        if kind not in free:
            return np.full(len(told), np.inf)
        if not told.any() or key in silent:
            return np.full(len(told), unknown)
        return np.where(told > 0.0, told, np.inf)

    surveys = [beacon.survey for beacon in site.beacons]
    position = of_kind(
        Free.POSITION, "[survey] position_sd_m", np.array([s.position_sd_m for s in surveys]), UNKNOWN_POSITION_M
    )
    axis = of_kind(Free.AXIS, "[survey] axis_sd_rad", np.array([s.axis_sd_rad for s in surveys]), UNKNOWN_AXIS_RAD)
    current = of_kind(Free.CURRENT, "[survey] current_sd", np.array([s.current_sd for s in surveys]), UNKNOWN_CURRENT)
    gain = of_kind(Free.GAIN, "[sensor] gain_sd", np.full(3, site.sensor.gain_sd), UNKNOWN_GAIN)
    lean = np.sqrt(2.0) * np.full(3, site.sensor.axis_sd_rad)  # the lean of either axis towards the other adds up
    tilt = of_kind(Free.TILT, "[sensor] axis_sd_rad", lean, UNKNOWN_TILT_RAD)
    offset = of_kind(Free.OFFSET, "offset", np.zeros(3), UNKNOWN_OFFSET_T)
    lever = of_kind(Free.LEVER, "lever_m", np.zeros(9), UNKNOWN_LEVER_M)
    of_beacons = np.column_stack([position, position, position, axis, axis, current])
    sd = np.concatenate([of_beacons.ravel(), gain, tilt, offset, lever, start.metal.sd(field_T)])
    return Prior(np.isfinite(sd), sd, start)
