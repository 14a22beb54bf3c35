"""The keys of a site file that say how beacons are told apart: what they mean, and a sentence for each wrong one."""

import pytest

from goldfield.cli import main
from goldfield.errors import UserError
from goldfield.site import load
from goldfield.site.drive import NO_CODE, Code

HEAD = """\
[site]
name = "room"
chip_period_s = 1e-4
degree = 10
{site}
[sensor]
noise_T = 2.0e-7
"""
BEACON = """
[[beacon]]
id = "{name}"
position_m = [0.0, 0.0, 0.0]
axis = [0.0, 0.0, 1.0]
turns = 19
radius_m = 0.149
current_A = 10.0
{keys}
"""


def write(tmp_path, site, *beacons):
    path = tmp_path / "site.toml"
    text = HEAD.format(site=site)
    path.write_text(text + "".join(BEACON.format(name="abc"[i], keys=keys) for i, keys in enumerate(beacons)))
    return path


def test_codes_of_all_kinds(tmp_path):
    keys = "codes = [\n  { code = 5 },\n  { code = 7, degree = 5, hold = 11, offset = 3 },\n]\ntau_s = 2e-5"
    site = load(write(tmp_path, "", keys, "code = 5\ntau_s = 1e-5"))
    first, second = site.beacons
    assert (site.access, site.slots) == ("cdma", 0)
    assert first.drive.codes == (Code(5, 10), Code(7, 5, offset=3, hold=11))
    assert (first.code, first.drive.tau_s) == (NO_CODE, 2e-5)
    assert (second.code, second.drive.codes, second.drive.tau_s) == (5, (), 1e-5)
    with pytest.raises(UserError, match=r'beacon "a" of the site "room" has no plain code'):
        _ = site.codes


def test_slots_and_tones(tmp_path):
    site = load(write(tmp_path, 'access = "tdma"\nslots = 3', "slot = 2", "slot = 0"))
    assert (site.access, site.slots, [beacon.drive.slot for beacon in site.beacons]) == ("tdma", 3, [2, 0])
    site = load(write(tmp_path, 'access = "fdma"', "frequency_Hz = 9.775", "frequency_Hz = 29.3255132"))
    assert [beacon.drive.periods for beacon in site.beacons] == [1, 3]


def test_a_dual_axis_beacon_is_a_cosine_and_a_sine_of_one_frequency(tmp_path):
    frequency = "frequency_Hz = 29.3255132"
    site = load(write(tmp_path, 'access = "fdma"', frequency, f'{frequency}\nwave = "sine"'))
    assert [(beacon.drive.periods, beacon.drive.wave) for beacon in site.beacons] == [(3, "cosine"), (3, "sine")]


@pytest.mark.parametrize("wave", ["cosine", "sine"])
def test_one_frequency_and_wave_is_one_beacon_s(tmp_path, wave):
    keys = f'frequency_Hz = 29.3255132\nwave = "{wave}"'
    with pytest.raises(UserError, match=rf':26: \[\[beacon\]\] 2: frequency_Hz is that of beacon "a".*"{wave}"'):
        load(write(tmp_path, 'access = "fdma"', keys, keys))


TDMA = 'access = "tdma"\nslots = 3'
BAD = [
    ('access = "tmda"', "code = 1", ":5: [site]: access is", "cdma, tdma, fdma"),
    ("slots = 3", "code = 1", ":5: [site]: slots belongs to", '"tdma"'),
    ('access = "tdma"', "slot = 1", "[site]: slots is missing", ":1"),
    ('access = "tdma"\nslots = 1024', "slot = 1", ":6: [site]: slots is 1024", "1 to 1023"),
    (TDMA, "slot = 3", ":17: [[beacon]] 1: slot is 3", "0 to 2"),
    (TDMA, "code = 3", ":17: [[beacon]] 1: code belongs to", '"cdma"'),
    ("", "slot = 3", ":16: [[beacon]] 1: slot belongs to", '"tdma"'),
    ("", "frequency_Hz = 3", ":16: [[beacon]] 1: frequency_Hz belongs to", '"fdma"'),
    ("", "", "[[beacon]] 1: code is missing", ":9"),
    ("", "code = 1\ntau_s = -1e-6", ":17: [[beacon]] 1: tau_s is -1e-06", "0.001 s"),
    ("", "code = 1\ntau_s = 1.0", ":17: [[beacon]] 1: tau_s is 1", "ten chips"),
    ("", "code = 1\ncodes = [{ code = 2 }]", ":17: [[beacon]] 1: codes and code", "one of them"),
    ("", "codes = []", ":16: [[beacon]] 1: codes must be one or more", "[]"),
    ("", "codes = [{ code = 1 }, { ofset = 2 }]", ":16: [[beacon]] 1: codes 2: ofset", '"offset"'),
    ("", "codes = [{ code = 1, degree = 8 }]", ":16: [[beacon]] 1: codes 1: degree is 8", "5, 6, 7, 9, 10, 11"),
    ("", "codes = [{ code = 1, degree = 11 }]", ":16: [[beacon]] 1: codes 1: degree makes", "1 to 1023"),
    ("", "codes = [{ code = 1, degree = 9, hold = 3 }]", ":16: [[beacon]] 1: codes 1: hold makes", "3 times 511"),
    ("", "codes = [{ code = 1, hold = 0 }]", ":16: [[beacon]] 1: codes 1: hold makes", "0 times 1023"),
    ("", "codes = [{ code = 33, degree = 5 }]", ":16: [[beacon]] 1: codes 1: code is 33", "0 to 32"),
    ("", "codes = [{ code = 1, offset = 1023 }]", ":16: [[beacon]] 1: codes 1: offset is 1023", "0 to 1022"),
    ('access = "fdma"', "frequency_Hz = 33.0", ":16: [[beacon]] 1: frequency_Hz is 33, 3.376 periods", "29.3255 Hz"),
    ('access = "fdma"', "frequency_Hz = 0.1", ":16: [[beacon]] 1: frequency_Hz is 0.1", "9.77517 Hz"),
    ("", 'code = 1\nwave = "sine"', ":17: [[beacon]] 1: wave belongs to", '"fdma"'),
    ('access = "fdma"', 'frequency_Hz = 9.775\nwave = "saw"', ':17: [[beacon]] 1: wave is "saw"', "cosine or sine"),
    (
        'access = "fdma"\ntone = "square"',
        'frequency_Hz = 9.775\nwave = "sine"',
        ":18: [[beacon]] 1: wave is",
        'tone = "sine"',
    ),
    ('access = "fdma"', "frequency_Hz = 9000.0", ":16: [[beacon]] 1: frequency_Hz is 9000", "1 to 511"),
]


@pytest.mark.parametrize(("site", "keys", "place", "advice"), BAD, ids=[f"{s} {k}".strip() or "-" for s, k, *_ in BAD])
def test_each_error_is_one_sentence_that_says_where(tmp_path, capsys, site, keys, place, advice):
    path = write(tmp_path, site, keys)
    assert main(["separate", "--site", str(path), "unused.csv"]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert place in message
    assert advice in message
