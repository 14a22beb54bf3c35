"""How one run of the integrity figures is made: numbers of poses, seeds, and what the site files say."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from goldfield.site import Site
from tests.bench.integrity_sites import EXACT, Errors, told

TUNING_SEED = 1


@dataclass(frozen=True)
class Run:
    """Options of a run.

    Attributes
    ----------
    poses : int
        Poses a row.
    epochs, faulty : int
        Epochs a row of the table of risks, without and with a fault.
    seed : int
    silent : bool
        Whether site files say nothing of errors, where they would else say that there are none.
    """

    poses: int
    epochs: int
    faulty: int
    seed: int
    silent: bool = False

    def rng(self, *row: str | int) -> np.random.Generator:
        """Return the generator of a row: it depends on seed and row alone, not on the rows before."""
        return np.random.default_rng([self.seed, *(zlib.crc32(str(part).encode()) for part in row)])

    @property
    def errors(self) -> Errors | None:
        return None if self.silent else EXACT

    def told(self, site: Site) -> Site:
        """Return a site as the host reads it in this run."""
        return told(site, self.errors)

    def __str__(self) -> str:
        use = "for tuning" if self.seed == TUNING_SEED else "fresh unless something was tuned with it"
        files = "say nothing of errors" if self.silent else "say that they are exact"
        return f"{self.poses} poses a row, seed {self.seed} ({use}); site files {files}"
