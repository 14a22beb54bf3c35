"""Draw the pictures of docs/how_it_works.md from a simulated bench: ``make how-it-works-pictures``.

The bench runs the scenario `prigge8` on host boards. Its raw samples, separated fields and poses are read with the
commands that any user has; only fields of a coil are computed here, by the host's own model.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
import numpy as np

from goldfield import load_site
from goldfield.access.gold import code_matrix
from goldfield.field.model import FieldModel
from hil_sim.clib import ROOT

mpl.use("Agg")
import matplotlib.pyplot as plt

CHIPS = 40
"""Chips of the cycle that the first picture shows."""
SECONDS = 20
TRUTH_M = np.array([0.9, 1.2, 0.8])
BESIDE = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5), "fontsize": 8}
"""A legend to the right of its picture."""
FIGURE = {"layout": "constrained", "dpi": 110}


def measure(folder: Path) -> None:
    """Run the bench; write samples.csv and poses.jsonl."""
    hil = [
        "hil",
        "prigge8",
        "--boards",
        "host",
        "--pace",
        "0",
        "--site",
        "room.toml",
        "--link",
        "sensor",
        "--can",
        "none",
    ]
    command = [sys.executable, "-m", "goldfield"]
    reading = ["--port", "./sensor", "--site", "room.toml"]
    with subprocess.Popen([*command, *hil], cwd=folder, stdout=subprocess.PIPE, text=True) as bench:
        try:
            assert bench.stdout is not None
            bench.stdout.readline()
            held = os.open(folder / "sensor", os.O_RDWR | os.O_NOCTTY)  # the bench waits for its reader
            for words, name in (
                (["samples", *reading, "--cycles", "1"], "samples.csv"),
                (["run", *reading, "--json", "--seconds", str(SECONDS)], "poses.jsonl"),
            ):
                with (folder / name).open("w", encoding="utf-8") as out:
                    subprocess.run([*command, *words], cwd=folder, stdout=out, check=True)
            os.close(held)
        finally:
            bench.terminate()


def draw_codes(folder: Path, picture: Path) -> None:
    """Draw what coils send, what the sensor samples, and what the correlation with every code makes of it."""
    site = load_site(folder / "room.toml")
    samples = np.genfromtxt(folder / "samples.csv", delimiter=",", skip_header=1)[:, 1:]
    shown = site.beacons[:3]
    chips = code_matrix(site.degree, [beacon.code for beacon in shown]).reshape(len(samples), -1)[:CHIPS]
    figure, axes = plt.subplots(3, 1, figsize=(8.6, 7.6), **FIGURE)
    time_ms = 1e3 * site.chip_period_s * np.arange(CHIPS + 1)
    for row, beacon in enumerate(shown):
        current = np.append(chips[:, row], chips[-1, row]) * 0.35 - row
        axes[0].step(time_ms, current, where="post", label=f"{beacon.id}, code {beacon.code}")
    axes[0].set(
        title="1. Three of eight coils: +10 A or -10 A, as the chip of the code says", yticks=[], xlim=(0, time_ms[-1])
    )
    axes[0].legend(**BESIDE)
    signal_uT = 1e6 * (samples - samples.mean(axis=0))[:CHIPS]
    axes[1].plot(time_ms[1:], signal_uT, "o-", markersize=3, linewidth=0.6)
    axes[1].set(
        title="2. The sensor: one sample of each axis at the end of each chip",
        ylabel="less the mean, uT",
        xlim=(0, time_ms[-1]),
    )
    axes[1].legend(["x", "y", "z"], **BESIDE)
    axes[1].set_xlabel("time, ms")
    every = code_matrix(site.degree, range(1025)).reshape(len(samples), -1).astype(float)
    sums_nT = 1e9 * np.linalg.norm(every.T @ (samples - samples.mean(axis=0)) / len(samples), axis=1)
    own = [beacon.code for beacon in site.beacons]
    axes[2].semilogy(sums_nT, ".", markersize=2, color="0.6", label="other codes: noise")
    axes[2].semilogy(own, sums_nT[own], "D", markersize=5, label="codes of the beacons")
    axes[2].set(
        title="3. One cycle correlated with each of 1025 codes",
        xlabel="code",
        ylabel="field, nT",
        xlim=(-3, 60),
        ylim=(0.5, None),
    )
    axes[2].legend(**BESIDE)
    figure.savefig(picture)
    others_nT = np.median(np.delete(sums_nT, own))
    print(f"{picture.name}: beacons {sums_nT[own].min():.0f} to {sums_nT[own].max():.0f} nT, others {others_nT:.1f} nT")


def draw_poses(folder: Path, picture: Path) -> None:
    """Draw the field of one coil, and the poses of a sensor at rest beside the truth and the declared covariance."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(8.6, 4.2), **FIGURE)
    beacon = load_site(folder / "room.toml").beacons[0]
    along, up = np.meshgrid(np.linspace(-2, 2, 120), np.linspace(-2, 2, 120))
    points = np.stack([along, np.zeros_like(along), up], axis=-1).reshape(-1, 3)
    field = FieldModel([beacon]).field(points + beacon.position_m).reshape(*along.shape, 3)
    strength = np.log10(1e9 * np.linalg.norm(field, axis=2))
    mesh = left.pcolormesh(along, up, strength, shading="auto", cmap="viridis", vmin=1, vmax=5)
    left.streamplot(along, up, field[..., 0], field[..., 2], color="white", linewidth=0.5, density=1.1, arrowsize=0.6)
    left.set(title=f"field of one coil ({beacon.id})", xlabel="distance, m", ylabel="height, m", aspect="equal")
    figure.colorbar(mesh, ax=left, label="log10 of the field in nT", shrink=0.85)
    poses = [json.loads(line) for line in (folder / "poses.jsonl").read_text().splitlines()]
    found_mm = 1e3 * (np.array([pose["position_m"] for pose in poses]) - TRUTH_M)
    right.plot(*found_mm[:, :2].T, ".", markersize=4, label=f"{len(poses)} poses")
    covariance = 1e6 * np.mean([pose["position_cov_m2"] for pose in poses], axis=0)[:2, :2]
    angle = np.linspace(0, 2 * np.pi, 200)
    ring = np.linalg.cholesky(covariance) @ np.array([np.cos(angle), np.sin(angle)]) * np.sqrt(-2 * np.log(0.05))
    distance2 = np.einsum("ni,ij,nj->n", found_mm[:, :2], np.linalg.inv(covariance), found_mm[:, :2])
    inside = 100 * np.mean(distance2 < -2 * np.log(0.05))
    right.plot(*ring, label="declared: 95 % within")
    right.plot(0, 0, "k+", markersize=12, label="truth")
    right.set(title="poses of a sensor at rest", xlabel="x, mm", ylabel="y, mm", aspect="equal")
    right.legend(fontsize=8, loc="upper right")
    figure.savefig(picture)
    rms_mm = np.sqrt(np.mean(np.sum(found_mm**2, axis=1)))
    print(f"{picture.name}: {len(poses)} poses, rms error {rms_mm:.1f} mm, {inside:.0f} % inside the ring")


def main() -> None:
    """Measure and draw."""
    with tempfile.TemporaryDirectory() as directory:
        folder = Path(directory)
        measure(folder)
        draw_codes(folder, ROOT / "docs/how_codes.png")
        draw_poses(folder, ROOT / "docs/how_poses.png")


if __name__ == "__main__":
    main()
