"""Draw docs/location.png from a seeded run: ``make location-map``.

Left: rms position error over the middle plane of Prigge and How's region and around it. Middle: error against the
Cramer-Rao bound, epoch by epoch. Right: how often each start leads to the right pose, by the size of the volume. The
measurements are magpylib's (true loops), with 2 mG of noise a sample and uniform random attitude.
"""

from __future__ import annotations

import sys
from pathlib import Path

import locate_trials as bench
import matplotlib as mpl
import numpy as np

from goldfield.field.model import FieldModel
from goldfield.locate.constellation import Constellation
from goldfield.locate.fit import Measurements
from goldfield.locate.locator import Locator
from goldfield.locate.starts import simple_magnitudes
from goldfield.locate.wahba import wahba

mpl.use("Agg")
import matplotlib.pyplot as plt

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "location.png"
SEED = 2026
CELLS, TRIALS_A_CELL = 29, 40
SIZES = (1.0, 1.5, 2.0, 2.5)
TRIALS_A_SIZE = 1500


def errors(site, run):
    """Distances of the located from the true positions."""
    poses = Locator(site).locate_many(bench.fields_of(site, run))
    return np.linalg.norm(np.array([pose.position_m for pose in poses]) - run.position_m, axis=1)


def draw_map(axes, site, rng):
    """Rms error in centimetres over the plane at half height."""
    x = np.linspace(-0.5, 2.63, CELLS)
    grid = np.stack([*np.meshgrid(x, x, indexing="ij"), np.full((CELLS, CELLS), 0.89)], axis=-1).reshape(-1, 3)
    error = errors(site, bench.trials(site, np.repeat(grid, TRIALS_A_CELL, axis=0), rng))
    rms = 100 * np.sqrt(np.mean(error.reshape(-1, TRIALS_A_CELL) ** 2, axis=1)).reshape(CELLS, CELLS)
    image = axes.pcolormesh(x, x, rms.T, shading="nearest", cmap="viridis", vmin=0.4, vmax=1.6)
    plt.colorbar(image, ax=axes, label="rms position error, cm", shrink=0.8)
    corners = np.array([beacon.position_m[:2] for beacon in site.beacons])
    axes.plot(*corners.T, "o", color="white", markeredgecolor="black", label="beacons (floor and ceiling)")
    axes.set(title="error at half height, 2 mG", xlabel="x, m", ylabel="y, m", aspect="equal")
    axes.legend(loc="lower left", fontsize=7)


def draw_bound(axes, site, rng):
    """Error against the bound."""
    run = bench.trials(site, bench.cube_positions(rng, 3000), rng)
    error, bound = errors(site, run), bench.bound_of(site, run)
    ratio = np.sqrt(np.mean((error / bound) ** 2))
    axes.loglog(100 * bound, 100 * error, ".", markersize=2, alpha=0.4)
    line = np.array([100 * bound.min(), 100 * bound.max()])
    axes.loglog(line, line, color="black", linewidth=1, label="error = bound (rms)")
    axes.set(
        title=f"inside: rms(error / bound) = {ratio:.3f}",
        xlabel="Cramer-Rao bound, cm",
        ylabel="position error, cm",
    )
    for axis, ticks in ((axes.xaxis, (0.2, 0.5, 1.0, 2.0)), (axes.yaxis, (0.05, 0.2, 1.0, 5.0))):
        axis.set_major_locator(mpl.ticker.FixedLocator(ticks))
        axis.set_major_formatter(mpl.ticker.FormatStrFormatter("%g"))
        axis.set_minor_formatter(mpl.ticker.NullFormatter())
    axes.legend(fontsize=7)
    print(f"inside, 3000 epochs: rms(error/bound) {ratio:.3f}")


def starts_of(site, run):
    """Positions after the full fit, from each start, by name."""
    model = FieldModel(site.beacons)
    constellation, measured = Constellation(model), Measurements(run.field_T, run.sigma_T)
    magnitude, known = measured.magnitude_T, measured.known
    centre = np.broadcast_to(model.centre_m.mean(axis=0), run.position_m.shape).copy()
    simple = simple_magnitudes(model, magnitude, run.sigma_T, known, weighted=False)
    full = bench.full_magnitudes(model, magnitude, run.sigma_T, known, simple)
    weight = 1.0 / run.sigma_T**2
    found = {}
    for name, start in (("centre", centre), ("simple magnitudes", simple), ("simple, then full magnitudes", full)):
        rotation = wahba(model.field(start), run.field_T, weight)
        found[name] = constellation.refine(measured, start, rotation).position_m
    found["ours"] = np.array([p.position_m for p in Locator(site).locate_many(bench.fields_of(site, run))])
    return found


def draw_starts(axes, site, rng):
    """Share of right poses by start and volume."""
    share = {}
    for size in SIZES:
        run = bench.trials(site, bench.cube_positions(rng, TRIALS_A_SIZE, size), rng)
        near = np.maximum(0.01, 8 * bench.bound_of(site, run))
        for name, position in starts_of(site, run).items():
            right = np.linalg.norm(position - run.position_m, axis=1) < near
            share.setdefault(name, []).append(100 * float(right.mean()))
    for name, values in share.items():
        axes.plot(SIZES, values, "o-", label=name)
        print(f"start {name}: " + ", ".join(f"{v:.2f} % at {s:g}x" for v, s in zip(values, SIZES, strict=True)))
    axes.set(title="no prior: right pose found", xlabel="edge of the volume / cube's", ylabel="%")
    axes.legend(fontsize=7)


def main() -> int:
    """Draw the three panels."""
    site, rng = bench.prigge_cube(), np.random.default_rng(SEED)
    figure, panels = plt.subplots(1, 3, figsize=(14, 4.2), layout="constrained")
    for draw, axes in zip((draw_map, draw_bound, draw_starts), panels, strict=True):
        draw(axes, site, rng)
    figure.savefig(PICTURE, dpi=110, metadata={"Software": None})
    print(f"wrote {PICTURE.relative_to(Path.cwd()) if PICTURE.is_relative_to(Path.cwd()) else PICTURE}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
