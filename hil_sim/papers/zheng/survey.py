"""``goldfield paper zheng survey``: a map of fingerprints from samples at known places."""

from __future__ import annotations

import argparse

import numpy as np

from goldfield.cli.chips_file import PLACE
from goldfield.errors import UserError, counted
from goldfield.files.outputs import check_outputs
from goldfield.types import FloatArray
from hil_sim.papers.zheng import sites
from hil_sim.papers.zheng.methods import map_file
from hil_sim.papers.zheng.methods.field_ellipse import rms_strength
from hil_sim.papers.zheng.methods.fingerprint import FingerprintMap
from hil_sim.papers.zheng.windows import read_windows


def run(arguments: argparse.Namespace) -> int:
    """Build and save a map; windows at one place make one point."""
    inputs = {"SAMPLES.csv": arguments.samples, "--site": arguments.site}
    check_outputs({"--map": arguments.map}, inputs, force=arguments.force)
    site = sites.measured_site(arguments, 3)
    names = tuple(beacon.id for beacon in sites.dual_axis_beacons(site).beacons)
    strengths: dict[tuple[float, ...], list[FloatArray]] = {}
    for window in read_windows(site, arguments.samples, arguments.separation):
        if window.place_m is None:
            raise UserError(f"{arguments.samples}: has no places: a survey needs the columns {','.join(PLACE)}")
        strength = rms_strength(window.field_T)[0]
        if not np.isfinite(strength).all():
            raise UserError(f"{arguments.samples}: window {window.window} lacks samples: leave it out of the survey")
        strengths.setdefault(tuple(window.place_m.tolist()), []).append(strength)
    means = np.array([np.mean(of_place, axis=0) for of_place in strengths.values()])
    map_file.save(FingerprintMap(names, np.array(list(strengths)), means), arguments.map, force=arguments.force)
    print(f"{arguments.map}: {counted(len(strengths), 'points')}, {counted(len(names), 'beacons')}")
    return 0
