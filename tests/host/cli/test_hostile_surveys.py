"""Hostile input of the commands that find out instead of assume: survey, plan and calibrate.

As in `test_hostile`: one sentence, never a traceback, never an answer that rests on what cannot be.
"""

import pytest

from goldfield.sensor.fields_table import FieldsWriter
from tests.bench.integrity_sites import text_of
from tests.bench.survey_trials import ASTRAY, cube, trial
from tests.host.calibration.turning import record
from tests.host.cli.test_hostile import check_refused


@pytest.fixture(scope="module")
def turned(tmp_path_factory):
    """A folder with the site and the fields of a sensor that is turned."""
    folder = tmp_path_factory.mktemp("turned")
    recording = record(folder, 1, cycles=60)
    with FieldsWriter(folder / "fields.csv", live=False) as table:
        for fields in recording.turn.fields(recording.site):
            table.write(fields)
    return folder


def changed(table, out, change):
    """Write a table with its cells changed, row by row; None leaves the row out."""
    header, *rows = table.read_text().splitlines()
    rows = [change(row.split(",")) for row in rows]
    out.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows if row is not None)]) + "\n")
    return out


WRONG_FIELDS = {
    "a dead axis": lambda c: [*c[:4], "0.0", *c[5:]],
    "too large": lambda c: [*c[:3], *(1e3 * float(x) for x in c[3:6]), *c[6:]],
    "far too large": lambda c: [*c[:3], "0.9", "0.9", "0.9", *c[6:]],
}


@pytest.mark.parametrize("wrong", WRONG_FIELDS)
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_sensor_is_not_calibrated_from_wrong_fields(turned, tmp_path, capsys, wrong):
    fields = changed(turned / "fields.csv", tmp_path / "f.csv", WRONG_FIELDS[wrong])
    told = check_refused(
        capsys, ["calibrate", "sensor", "--site", turned / "site.toml", "--fields", fields], codes=(2, 3)
    )
    assert any(part in told for part in ("the best fit leaves", "cycles fit one sensor", "reads almost nothing"))
