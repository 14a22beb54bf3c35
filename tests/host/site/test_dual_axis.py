"""The coils of a site file of boards put together as dual-axis beacons, and a sentence for those that are no pair."""

import pytest

from goldfield.errors import UserError
from goldfield.site import dual_axis, load
from tests.host.site.dual_axis_site import CHIP_S, N, coils, write


def changed(index, **keys):
    rows = list(coils())
    rows[index] = {**rows[index], **keys}
    return rows


WRONG = [
    (changed(1, id="a.sinus"), '"a.cos" of the site "hall" is no half'),
    (list(coils())[:3], '"b.cos" of the site "hall" is no half'),
    (changed(1, place=[0, 0, 1]), 'position_m of "a.cos" and "a.sin" differ'),
    (changed(1, current=7.0), "current_A of"),
    (changed(1, frequency=repr(5 / (N * CHIP_S))), "frequency_Hz of"),
    (changed(3, axis=[0.1, 1, 0]), 'the axes of "b.cos" and "b.sin" are more than 1 degree off'),
    (changed(3, axis=[0, 1, 0]), 'the coils of "b" turn against the others'),
]


@pytest.mark.parametrize(("rows", "message"), WRONG, ids=[message for _, message in WRONG])
def test_coils_that_are_no_pair_are_told(tmp_path, rows, message):
    with pytest.raises(UserError, match=message):
        dual_axis.of_site(load(write(tmp_path, rows)))


def test_a_half_space_that_tells_no_side_is_told(tmp_path):
    sideways = write(tmp_path, coils(), "half_space = { point = [0, 0, 0], normal = [1, 0, 0] }")
    with pytest.raises(UserError, match=r"half_space of the site .* does not tell on which side"):
        dual_axis.of_site(load(sideways))
