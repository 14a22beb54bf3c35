"""``goldfield calibrate``: what a sensor and coils are really like, from recordings made for it."""

from __future__ import annotations

import argparse
from typing import Any

from goldfield.cli import link_options, options
from goldfield.cli.page_option import add_view
from goldfield.errors import on_command_line

SENSOR = "gains, directions and offset of a sensor's axes, by turning it by hand"
COILS = "time constants and polarity of coils, from raw samples"
RESTORE = "give a board what was kept of it"


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser("calibrate", description=f"sensor: {SENSOR}. coils: {COILS}. restore: {RESTORE}.")
    actions = parser.add_subparsers(dest="action", required=True, metavar="sensor|coils|restore")
    _add_sensor(actions.add_parser("sensor", help=SENSOR, description=SENSOR_TEXT))
    _add_coils(actions.add_parser("coils", help=COILS, description=COILS_TEXT))
    restore = actions.add_parser("restore", help=RESTORE, description=RESTORE_TEXT)
    link_options.add(restore)
    options.add(restore, "--node", metavar="N", kind=options.node, what="node of the sensor (else the only one)")
    restore.add_argument("--sensors", metavar="FILE", required=True, help="file of sensors that calibrate has written")
    parser.set_defaults(run=run)


SENSOR_TEXT = (
    "Turn the sensor by hand, slowly, in one place where it hears its beacons, for a minute: each axis up, down and to "
    "all sides. Gains and directions follow from the earth's field and the beacons', the offset from the earth's."
)
COILS_TEXT = (
    "From samples of a sensor at rest (goldfield samples): the time constant of each coil, and whether its polarity is "
    "as the site says. With --at, or the columns x_m to z_m, any number of coils may be reversed."
)
RESTORE_TEXT = "The board is known by the unique id of its processor, whatever its node or port is."


def _add_sensor(parser: argparse.ArgumentParser) -> None:
    link_options.add(parser, log=True)
    parser.add_argument("--fields", metavar="FILE", help="table of fields instead of a link: without the offset")
    options.add_site(parser)
    options.add(parser, "--node", metavar="N", kind=options.node, what="node of the sensor (else the only one)")
    parser.add_argument(
        "--seconds", type=options.seconds, metavar="N", help="how long to read: live 60 s, a recording to its end"
    )
    parser.add_argument("--out", metavar="FILE", help="write the site file with the sensor's axes and deviations")
    parser.add_argument("--sensors", metavar="FILE", help="keep the calibration there, with the board's unique id")
    parser.add_argument("--unique-id", metavar="ID", help="of the board, for --sensors with a recording")
    parser.add_argument("--write", action="store_true", help="set the board's zero and calibration (live)")
    parser.add_argument("--accept-weak", action="store_true", help="with --write: set the board to a weak one, too")
    add_view(parser)
    options.add_json(parser)
    options.add_force(parser)


def _add_coils(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("samples", metavar="SAMPLES.csv", help="table of samples; - is stdin")
    options.add_site(parser)
    parser.add_argument("--at", type=options.finite, nargs=3, metavar=("X", "Y", "Z"), help="where the sensor stood, m")
    parser.add_argument(
        "--out", metavar="FILE", help="write the site file with tau_s, and the current of reversed coils negated"
    )
    options.add_json(parser)
    options.add_force(parser)


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Calibrate."""
    from goldfield.cli import calibrations  # heavy: only when something is calibrated

    return calibrations.ACTIONS[arguments.action](arguments)
