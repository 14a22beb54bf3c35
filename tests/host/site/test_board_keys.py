"""The keys of a beacon that name its board."""

import pytest

from goldfield import UserError
from goldfield.site import load
from goldfield.site.board_keys import BeaconBoard

HEAD = '[site]\nname = "s"\nchip_period_s = 97.75e-6\ndegree = 10\n[sensor]\nnoise_T = 2e-7\n'
COIL = "position_m = [{i}.0, 0.0, 0.0]\naxis = [0.0, 0.0, 1.0]\nturns = 19\nradius_m = 0.149\ncurrent_A = 10.0\n"
ID = "0102030405060708090a0b0c"


def loaded(tmp_path, *keys):
    text = HEAD
    for i, key in enumerate(keys):
        text += f'[[beacon]]\nid = "b{i}"\ncode = {i + 2}\n' + COIL.format(i=i) + key + "\n"
    path = tmp_path / "site.toml"
    path.write_text(text)
    return load(path)


def test_what_a_beacon_says_of_its_board(tmp_path):
    site = loaded(tmp_path, "", "node = 4095\ngroup = 255", f'board = "{ID.upper()}"\ngroup = 0')
    assert [beacon.board for beacon in site.beacons] == [
        BeaconBoard(),
        BeaconBoard(node=4095, group=255),
        BeaconBoard(unique_id=ID, group=0),
    ]


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        (["node = 0"], "numbers of nodes are 1 to 4095"),
        (["node = 4096"], "numbers of nodes are 1 to 4095"),
        (["group = 256"], "groups are 1 to 255"),
        (["group = -1"], "groups are 1 to 255"),
        (['board = "12"'], "24 hexadecimal digits"),
        ([f'node = 1\nboard = "{ID}"'], "both given"),
        (["node = 1", "node = 1"], 'which beacon "b0" already has'),
        ([f'board = "{ID}"', f'board = "{ID.upper()}"'], 'which beacon "b0" already has'),
    ],
)
def test_what_is_no_board_is_refused(tmp_path, keys, said):
    with pytest.raises(UserError, match=said):
        loaded(tmp_path, *keys)
