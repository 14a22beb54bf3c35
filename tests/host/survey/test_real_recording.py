"""A survey of a real three-coil source and sensor on every second position, and poses on the others.

`data/README.md` tells where the recording comes from.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield import site as sites
from goldfield.locate import Locator
from goldfield.sensor.fields_table import read_fields
from goldfield.survey import Free, SurveyData, survey
from goldfield.survey.data import KnownPoint
from goldfield.types import Status

DATA = Path(__file__).with_name("data")
SITE = """[site]
name = "ilemt"
chip_period_s = 1e-4
degree = 10
{half_space}

[sensor]
noise_T = 3.2e-9
gain_sd = 0.1
axis_sd_rad = 0.05

[survey]
position_sd_m = 0.005
axis_sd_rad = 0.1
current_sd = 0.2
"""
BEACON = """
[[beacon]]
id = "{name}"
position_m = [0.0, -0.245, 0.0]
axis = {axis}
turns = 20.0
radius_m = 0.02
current_A = 0.575
code = {code}
"""
HALF_SPACE = "half_space = {point = [0.0, -0.245, 0.0], normal = [0.0, 1.0, 0.0]}"
FREE = frozenset((Free.POSITION, Free.AXIS, Free.CURRENT, Free.GAIN, Free.TILT))


class Recording:
    """The recording, surveyed on every second position by a site that has one coil the wrong way round."""

    def __init__(self, folder: Path, half_space: str, free: frozenset[Free] = FREE) -> None:
        text = SITE.format(half_space=half_space)
        for code, (name, axis) in enumerate((("A", [0, 1, 0]), ("B", [1, 0, 0]), ("C", [0, 0, 1])), start=2):
            text += BEACON.format(name=name, axis=axis, code=code)
        (folder / "site.toml").write_text(text)
        site = sites.load(folder / "site.toml")
        epochs = list(read_fields(site, DATA / "ilemt_fields.csv"))
        with (DATA / "ilemt_poses.csv").open() as file:
            rows = {int(row["epoch"]): row for row in csv.DictReader(file)}
        place = np.array([[float(rows[one.epoch][f"{k}_m"]) for k in "xyz"] for one in epochs])
        yaw = np.array([float(rows[one.epoch]["yaw_deg"]) for one in epochs])
        points = tuple(KnownPoint(one.epoch, at, 2e-4) for one, at in zip(epochs[::2], place[::2], strict=True))
        self.result = survey(site, SurveyData(tuple(epochs[::2]), points), free)
        self.poses = Locator(self.result.site).locate_many(epochs[1::2])
        self.place, self.yaw = place[1::2], Rotation.from_euler("z", yaw[1::2, None], degrees=True)

    def errors_m(self, positions_m: np.ndarray) -> np.ndarray:
        return np.linalg.norm(positions_m - self.place, axis=1)

    def figures(self) -> tuple[float, float]:
        """Return the root mean square errors of position, mm, and attitude, degrees, the whole sensor's turn aside."""
        error = self.errors_m(np.array([pose.position_m for pose in self.poses]))
        seen = self.yaw.inv() * Rotation.from_quat([pose.orientation_xyzw for pose in self.poses])
        turn = (seen.mean().inv() * seen).magnitude()
        return 1e3 * float(np.sqrt(np.mean(error**2))), float(np.rad2deg(np.sqrt(np.mean(turn**2))))


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return Recording(tmp_path_factory.mktemp("ilemt"), HALF_SPACE)


def test_the_reversed_coil_is_found(recording):
    assert recording.result.advice[0].startswith("B is reversed")
    assert recording.result.residual_after < 1.3
    assert len(recording.result.outliers) < 10


def test_poses_at_positions_that_the_survey_has_not_seen(recording):
    position_mm, attitude_deg = recording.figures()
    print(f"held-out positions: {position_mm:.2f} mm, {attitude_deg:.2f} degrees rms")
    assert position_mm < 0.5
    assert attitude_deg < 0.2


def test_the_coils_of_the_sensor_sit_at_different_points(recording, tmp_path):
    """Half a millimetre apart, each known to some hundredths: the poses are nearer by a third."""
    apart = Recording(tmp_path, HALF_SPACE, FREE | {Free.LEVER})
    position_mm, attitude_deg = apart.figures()
    print(f"with levers: {position_mm:.2f} mm, {attitude_deg:.2f} degrees rms")
    assert position_mm < min(0.3, 0.7 * recording.figures()[0])
    assert attitude_deg < 0.2
    levers = apart.result.site.sensor.lever_m
    assert 1e-4 < np.linalg.norm(levers[0] - levers[1]) < 1e-3


def test_without_a_half_space_the_other_side_is_given_as_the_alternative(tmp_path):
    recording = Recording(tmp_path, "")
    ambiguous = [pose.status is Status.AMBIGUOUS for pose in recording.poses]
    assert sum(ambiguous) > 30
    first = np.array([pose.position_m for pose in recording.poses])
    second = np.array([(pose.alternative or pose).position_m for pose in recording.poses])
    error = np.minimum(recording.errors_m(first), recording.errors_m(second))
    assert np.sqrt(np.mean(error**2)) < 0.0005
