"""What ``make drive-figures`` measures, for the driver and the waveform that were worst."""

import pytest

from tests.bench import drive_figures


@pytest.mark.parametrize("driver", ["directions 2 % apart, DC 0.1 A", "all of these, offset 0.05 A"])
def test_a_rotating_field_of_2_A_is_right_to_a_thousandth(driver):
    amplitude, direct = drive_figures.errors("rotating, 37", driver, 2.0)
    assert amplitude < 1e-3
    assert direct < 0.5e-3
