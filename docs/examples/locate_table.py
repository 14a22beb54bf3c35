"""Locate a table of separated fields: ``python locate_table.py [FIELDS.csv SITE.toml]``.

The table has the columns epoch, t_s, beacon, bx_T, by_T, bz_T and perhaps sigma_T: fields in the sensor's frame.
"""

import sys
from pathlib import Path

import numpy as np

import goldfield

HERE = Path(__file__).parent


def main(table: Path | str = HERE / "fields.csv", site_file: Path | str = HERE / "room.toml") -> None:
    """Print the position of each epoch with its standard deviation."""
    site = goldfield.load_site(site_file)
    locator = goldfield.Locator(site)
    for pose in locator.locate_many(list(goldfield.read_fields(site, table))):
        x, y, z = pose.position_m
        sigma_mm = 1e3 * np.sqrt(np.trace(pose.position_cov_m2))
        print(f"epoch {pose.epoch}: {x:.3f} {y:.3f} {z:.3f} m, within {sigma_mm:.0f} mm (1 sigma), {pose.status}")


if __name__ == "__main__":
    main(*sys.argv[1:3])
