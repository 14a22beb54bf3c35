"""What tests of single steps of a search put in the place of the steps around it."""

from __future__ import annotations

import numpy as np

from goldfield.locate import kernel
from goldfield.locate.fit import Fit, Measurements

SIGMA_T = 1e-9


def fits(cost, position=None, converged=True):
    """Fits of these costs; the place tells which is which."""
    count = len(cost)
    place = np.arange(count)[:, None] * np.ones(3) if position is None else np.array(position, dtype=float)
    turn = np.repeat(np.eye(3)[None], count, axis=0)
    done = np.broadcast_to(np.asarray(converged), count).copy()
    return Fit(place, turn, np.array(cost, dtype=float), np.zeros((count, 6, 6)), done)


class Asked:
    """Notes what a constellation asks of its own steps, and answers with what is given."""

    def __init__(self, monkeypatch, constellation, **answers):
        self.calls = []
        for name, answer in answers.items():
            monkeypatch.setattr(constellation, name, self._noting(name, answer))

    def _noting(self, name, answer):
        def step(*arguments, **options):
            self.calls.append((name, arguments, options))
            return answer(*arguments, **options) if callable(answer) else answer

        return step

    @property
    def names(self):
        return [name for name, *_ in self.calls]

    def told(self, name):
        return [arguments for of, arguments, _ in self.calls if of == name]


def without_kernel(monkeypatch):
    monkeypatch.setattr(kernel, "_library", lambda: None)


def of_axes(run, axes, beacons):
    field = run.field_T[:, :beacons].copy()
    field[:, :, axes:] = np.nan
    return Measurements(field, run.sigma_T[:, :beacons])
