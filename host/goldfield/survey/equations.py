"""The normal equations of an adjustment, and their solution with the poses eliminated (Schur complement).

A component c of the reading of a beacon's field B is y_c = b_c . B + o_c, where b_c is row c of (I + E) A R'. With
m_c = b_c' G, the gradient G of the field and q the sensor seen from the coil, its derivatives are: by the sensor's
place m_c, by its turn b_c x B, by the coil's place -m_c, by the coil's turn m_c x q - b_c x B, by the logarithm of the
current b_c . B, and by E_cd the component d of A R' B. All is taken where the axis reads, at p + R lever_c: by the
lever the derivative is m_c R, and that by the turn has (R lever_c) x m_c, too.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.site.metal import COLUMNS, ROWS
from goldfield.survey.metal import effects_of_bodies, effects_of_harmonics
from goldfield.survey.parameters import ANCHOR, BEACON, LEVER, OFFSET, SENSOR, TERMS, State, across
from goldfield.types import FloatArray


@dataclass(frozen=True, eq=False)
class Readings:
    """Measured fields of e epochs.

    Attributes
    ----------
    field_T : ndarray, shape (e, n, 3)
        In the sensor's frame; 0 where not measured.
    sigma_T : ndarray, shape (e, n, 3)
        Standard deviations; infinite where not measured.
    """

    field_T: FloatArray
    sigma_T: FloatArray

    def weight(self, model_error: float) -> FloatArray:
        """Return reciprocal standard deviations, with a relative error of the model, shape (e, n, 3)."""
        size2 = (self.field_T**2).sum(axis=2, keepdims=True)
        return np.asarray(1.0 / np.sqrt(self.sigma_T**2 + model_error**2 * size2))

    @property
    def count(self) -> FloatArray:
        """Number of measured components of each epoch, shape (e,)."""
        return np.asarray(np.isfinite(self.sigma_T).sum(axis=(1, 2)), dtype=float)


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Residuals of e epochs and their derivatives, not whitened.

    Attributes
    ----------
    residual : ndarray, shape (e, n, 3)
        Measured less modelled.
    pose : ndarray, shape (e, n, 3, 6)
        Derivatives of the model by shift and turn of the sensor.
    beacon : ndarray, shape (e, n, 3, 6)
        By the parameters of the beacon.
    sensor : ndarray, shape (e, n, 3, 18)
        By those of the sensor.
    harmonics : ndarray, shape (e, n, 3, C)
        By the metal's polynomials of the beacon.
    bodies : ndarray, shape (e, n, 3, 9 k)
        By the metal's bodies.
    """

    residual: FloatArray
    pose: FloatArray
    beacon: FloatArray
    sensor: FloatArray
    harmonics: FloatArray
    bodies: FloatArray


def derivatives(
    model: FieldModel,
    state: State,
    axes: FloatArray,
    field_T: FloatArray,
    point_m: FloatArray,
    rotation: FloatArray,
    matrix: FloatArray,
) -> Derivatives:
    """Return residuals and derivatives; a sensor with levers takes three times as long as one without.

    The levers of the state, shape (3, 3), may also be those of each epoch, shape (e, 3, 3).

    Parameters
    ----------
    model : FieldModel
        The beacons as the state has them.
    state : State
    axes : ndarray, shape (3, 3)
        The sensor's axes as the site says, A.
    field_T : ndarray, shape (e, n, 3)
    point_m, rotation : ndarray, shapes (e, 3) and (e, 3, 3)
        Poses of the sensor.
    matrix : ndarray, shape (3, 3) or (e, 3, 3)
        I + E.
    """
    arm = rotation @ state.lever_m.swapaxes(-1, -2)  # (e, 3, axis)
    if not state.lever_m.any():
        return _at(model, state, axes, field_T, point_m, rotation, matrix, arm)
    each = [_at(model, state, axes, field_T, point_m + arm[:, :, c], rotation, matrix, arm) for c in range(3)]
    names = [field.name for field in fields(Derivatives)]
    return Derivatives(
        *(np.stack([getattr(one, name)[:, :, c] for c, one in enumerate(each)], axis=2) for name in names)
    )


def _at(
    model: FieldModel,
    state: State,
    axes: FloatArray,
    field_T: FloatArray,
    point_m: FloatArray,
    rotation: FloatArray,
    matrix: FloatArray,
    lever_arm_m: FloatArray,
) -> Derivatives:
    """Return the same as if all axes read at the points; the columns of ``lever_arm_m``, (e, 3, 3), are R lever."""
    point = np.ascontiguousarray(point_m.T)
    field, gradient = model.evaluate(point)
    of_coil = (field, gradient) if model.metal is None else model.evaluate_coils(point)
    field, gradient = field.transpose(1, 2, 0), gradient.transpose(2, 3, 0, 1)  # (e, n, 3), (e, n, 3, 3)
    coil_field, coil_gradient = of_coil[0].transpose(1, 2, 0), of_coil[1].transpose(2, 3, 0, 1)
    bare = axes @ rotation.swapaxes(1, 2)
    rows = (matrix @ bare)[:, None]  # (e, 1, c, 3)
    slope = rows @ gradient
    turn = _cross(rows, field[:, :, None]) + _cross(lever_arm_m.swapaxes(1, 2)[:, None], slope)
    arm = (point_m[:, None] - state.position_m)[:, :, None]
    reading = (rows @ field[..., None])[..., 0]
    beacon = np.empty((*field.shape, BEACON))
    by_coil = rows @ coil_gradient
    beacon[..., :3] = -by_coil
    by_turn = _cross(by_coil, arm) - _cross(rows, coil_field[:, :, None])
    beacon[..., 3:5] = by_turn @ across(state.axis).swapaxes(1, 2)
    beacon[..., 5] = reading
    sensor = np.zeros((*field.shape, SENSOR))
    sensor[:, :, ROWS, np.arange(TERMS)] = (bare[:, None] @ field[..., None])[..., 0][:, :, COLUMNS]
    sensor[:, :, :, OFFSET] = np.eye(3)
    by_lever = slope @ rotation[:, None]
    for c in range(3):
        sensor[:, :, c, LEVER][..., 3 * c : 3 * c + 3] = by_lever[:, :, c]
    return Derivatives(
        field_T - reading - state.offset_T,
        np.concatenate([slope, turn], axis=3),
        beacon,
        sensor,
        rows @ effects_of_harmonics(state.metal, np.exp(state.log_current), point_m),
        rows @ effects_of_bodies(state.metal, model, point_m),
    )


def _cross(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return cross products along the last axis; much quicker than `numpy.cross` on small arrays."""
    (a, b, c), (x, y, z) = np.moveaxis(left, -1, 0), np.moveaxis(right, -1, 0)
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=-1)


@dataclass(frozen=True, eq=False)
class Group:
    """Normal equations of epochs, each with k unknowns of its own.

    Attributes
    ----------
    own : ndarray, shape (e, k, k)
    cross : ndarray, shape (e, k, g)
        Between an epoch's own and the common unknowns.
    gradient : ndarray, shape (e, k)
    """

    own: FloatArray
    cross: FloatArray
    gradient: FloatArray


Eliminated = tuple[FloatArray, FloatArray, FloatArray]
"""What is needed to find the epochs' own unknowns again, with L L' their damped matrix: L^-T, L^-1 cross and
L^-1 gradient."""


@dataclass(frozen=True, eq=False)
class Equations:
    """Normal equations: of the g common unknowns, and of groups of epochs.

    Attributes
    ----------
    common : ndarray, shape (g, g)
    gradient : ndarray, shape (g,)
    groups : tuple of Group
    """

    common: FloatArray
    gradient: FloatArray
    groups: tuple[Group, ...]

    def reduced(self, damping: float = 0.0) -> tuple[FloatArray, FloatArray, list[Eliminated]]:
        """Eliminate the epochs.

        Returns
        -------
        matrix, vector : ndarray, shapes (g, g) and (g,)
            The reduced equations.
        parts : list of Eliminated
            One of each group.
        """
        matrix = self.common + np.diag(damping * np.diag(self.common))
        vector, parts = self.gradient.copy(), []
        for group in self.groups:
            size = group.own.shape[1]
            diagonal = np.einsum("ekk->ek", group.own)
            own = group.own + (damping * diagonal + 1e-12 * diagonal.max(axis=1, keepdims=True) + 1e-300)[
                ..., None
            ] * np.eye(size)
            back = np.linalg.inv(np.linalg.cholesky(own))
            crossed = back @ group.cross
            known = (back @ group.gradient[..., None])[..., 0]
            flat = crossed.reshape(crossed.shape[0] * crossed.shape[1], crossed.shape[2])
            matrix = matrix - flat.T @ flat
            vector = vector - flat.T @ known.ravel()
            parts.append((back.swapaxes(1, 2), crossed, known))
        return matrix, vector, parts

    def step(self, damping: float) -> tuple[FloatArray, list[FloatArray], float]:
        """Return the damped step of the common unknowns, that of each group, and the decrease that it promises."""
        matrix, vector, parts = self.reduced(damping)
        common = solved(matrix, vector)
        steps = [(back @ (known - crossed @ common)[..., None])[..., 0] for back, crossed, known in parts]
        promise = float(self.gradient @ common)
        for group, step in zip(self.groups, steps, strict=True):
            promise += float((group.gradient * step).sum())
        return common, steps, promise


def solved(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Solve symmetric equations whose unknowns have different units; those without any information stay 0."""
    scale = _scale(matrix)
    return np.asarray(scale * np.linalg.solve(_unit(matrix, scale), scale * vector))


def inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse of an information matrix; rows of unknowns without any information are 0."""
    scale = _scale(matrix)
    return np.asarray(scale[:, None] * np.linalg.inv(_unit(matrix, scale)) * scale)


def _scale(matrix: FloatArray) -> FloatArray:
    diagonal = np.diag(matrix)
    return np.asarray(np.where(diagonal > 0.0, 1.0 / np.sqrt(np.maximum(diagonal, 1e-300)), 0.0))


def _unit(matrix: FloatArray, scale: FloatArray) -> FloatArray:
    unit = scale[:, None] * matrix * scale
    return np.asarray(unit + np.diag(np.where(scale > 0.0, 1e-13, 1.0)))


def _order(beacons: int, harmonics: int, bodies: int) -> NDArray[np.intp]:
    """Return where the common unknowns stand while those of a beacon are together, then those of sensor and bodies."""
    width = BEACON + harmonics
    blocks = np.arange(beacons * width).reshape(beacons, width)
    shared = beacons * width + np.arange(SENSOR + bodies)
    parts = (blocks[:, :BEACON].ravel(), shared[:SENSOR], blocks[:, BEACON:].ravel(), shared[SENSOR:])
    return np.concatenate(parts)


def walk_equations(parts: Derivatives, weight: FloatArray) -> tuple[FloatArray, FloatArray, Group]:
    """Return the normal equations of the sensor's epochs: common matrix, common gradient, and their group.

    Parameters
    ----------
    parts : Derivatives
    weight : ndarray, shape (e, n, 3)
        Root of the weight of each component.
    """
    epochs, beacons = weight.shape[:2]
    residual = parts.residual * weight
    pose = parts.pose * weight[..., None]
    own_part = np.concatenate([parts.beacon, parts.harmonics], axis=3) * weight[..., None]
    shared = np.concatenate([parts.sensor, parts.bodies], axis=3) * weight[..., None]
    width, rest = own_part.shape[3], shared.shape[3]
    count = width * beacons
    size = count + rest
    common, gradient = np.zeros((size, size)), np.zeros(size)
    by_beacon = own_part.transpose(1, 0, 2, 3).reshape(beacons, 3 * epochs, width)
    shared_too = shared.transpose(1, 0, 2, 3).reshape(beacons, 3 * epochs, rest)
    of_beacons = by_beacon.swapaxes(1, 2) @ by_beacon
    for i in range(beacons):
        place = slice(width * i, width * (i + 1))
        common[place, place] = of_beacons[i]
    common[:count, count:] = (by_beacon.swapaxes(1, 2) @ shared_too).reshape(count, rest)
    common[count:, :count] = common[:count, count:].T
    flat = shared.reshape(-1, rest)
    common[count:, count:] = flat.T @ flat
    gradient[:count] = np.einsum("encp,enc->np", own_part, residual).ravel()
    gradient[count:] = flat.T @ residual.ravel()
    of_pose = pose.reshape(epochs, 3 * beacons, 6).swapaxes(1, 2)
    cross = np.empty((epochs, 6, size))
    cross[:, :, :count] = (pose.swapaxes(2, 3) @ own_part).transpose(0, 2, 1, 3).reshape(epochs, 6, count)
    cross[:, :, count:] = of_pose @ shared.reshape(epochs, 3 * beacons, rest)
    own = of_pose @ of_pose.swapaxes(1, 2)
    own_gradient = (of_pose @ residual.reshape(epochs, 3 * beacons, 1))[..., 0]
    order = _order(beacons, parts.harmonics.shape[3], parts.bodies.shape[3])
    return common[np.ix_(order, order)], gradient[order], Group(own, cross[:, :, order], own_gradient)


def anchor_equations(
    parts: Derivatives, weight: FloatArray, beacon_rows: list[int]
) -> tuple[FloatArray, FloatArray, Group]:
    """Return the normal equations of anchors, each with attitude, terms and lever of its sensor as its own unknowns.

    Parameters
    ----------
    parts : Derivatives
        One epoch an anchor.
    weight : ndarray, shape (a, n, 3)
    beacon_rows : list of int
        The beacon where each anchor's sensor stands.
    """
    anchors, beacons = weight.shape[:2]
    harmonics = parts.harmonics.shape[3]
    first = BEACON * beacons + SENSOR
    size = first + harmonics * beacons + parts.bodies.shape[3]
    residual = (parts.residual * weight).reshape(anchors, -1)
    common = np.zeros((anchors, beacons, 3, size))
    for i in range(beacons):
        common[:, i, :, BEACON * i : BEACON * (i + 1)] = parts.beacon[:, i]
        common[:, i, :, first + harmonics * i : first + harmonics * (i + 1)] = parts.harmonics[:, i]
    common[..., first + harmonics * beacons :] = parts.bodies
    for a, row in enumerate(beacon_rows):
        common[a, :, :, BEACON * row : BEACON * row + 3] += parts.pose[a, :, :, :3]
    common = (common * weight[..., None]).reshape(anchors, -1, size)
    lever = parts.sensor[..., LEVER].reshape(anchors, beacons, 3, 3, 3).sum(axis=3)  # all axes read at one place
    own = np.concatenate([parts.pose[..., 3:], parts.sensor[..., :TERMS], lever], axis=3)
    own = (own * weight[..., None]).reshape(anchors, 3 * beacons, ANCHOR)
    back = own.swapaxes(1, 2)
    flat = common.reshape(-1, size)
    group = Group(back @ own, back @ common, (back @ residual[..., None])[..., 0])
    return flat.T @ flat, flat.T @ residual.ravel(), group
