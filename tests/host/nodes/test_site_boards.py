"""Which board is whose: what two boards, or two beacons, have in common is refused and told, and nothing is guessed."""

import pytest

from goldfield import site as sites
from goldfield.errors import UserError
from goldfield.nodes.commissioning import Board, assigned
from goldfield.nodes.names import name_of
from goldfield.nodes.site_boards import wanted_of

A, B, C = "0a" * 12, "0b" * 12, "0c" * 12


@pytest.fixture
def site(tmp_path):
    """A function that makes a site of two beacons with these further keys."""
    path = tmp_path / "room.toml"

    def make(*keys):
        beacons = [
            f'[[beacon]]\nid = "b{i}"\nposition_m = [{i}, 0, 0]\naxis = [0, 0, 1]\nradius_m = 0.1\nturns = 20\n'
            f"current_A = 5\ncode = {i + 2}\n{text}\n"
            for i, text in enumerate(keys, start=1)
        ]
        path.write_text(
            '[site]\nname = "room"\ndegree = 10\nchip_period_s = 97.75e-6\n[sensor]\nnoise_T = 2e-7\n'
            + "".join(beacons)
        )
        return sites.load(path)

    return make


def test_boards_of_their_own_are_found(site):
    wanted, missing = wanted_of(
        site(f'board = "{A}"', "node = 4"), [Board(A, 3, "beacon"), Board(B, 4, "beacon"), Board(C, 5, "sensor")]
    )
    assert ([(one.owner, one.board.number) for one in wanted], missing) == ([("b1", 3), ("b2", 4), ("sensor", 5)], [])


def test_a_board_that_shares_its_number_is_nobodys(site):
    """What is set goes to a number: the other board would have it, too."""
    boards = [Board(A, 3, "beacon"), Board(B, 3, "beacon"), Board(C, 5, "sensor")]
    wanted, missing = wanted_of(site(f'board = "{A}"', f'board = "{B}"'), boards)
    assert [one.owner for one in wanted] == ["sensor"]
    assert [text.partition(":")[0] for text in missing] == ['beacon "b1"', 'beacon "b2"']
    assert all("shares its number 3 with another one: goldfield nodes assign" in text for text in missing)


def test_a_sensor_that_shares_its_number_is_not_set(site):
    boards = [Board(A, 3, "beacon"), Board(B, 4, "beacon"), Board(C, 5, "sensor"), Board("0d" * 12, 5, "sensor")]
    wanted, missing = wanted_of(site(f'board = "{A}"', f'board = "{B}"'), boards)
    assert [one.owner for one in wanted] == ["b1", "b2"]
    told = [text.partition(" with another one")[0] for text in missing]
    assert told == [f"sensor: board {one} shares its number 5" for one in (C, "0d" * 12)]


def test_two_beacons_do_not_get_one_board(site):
    """One names it by its number, the other one has its name."""
    boards = [Board(A, 3, "beacon", name="b2"), Board(C, 5, "sensor")]
    wanted, missing = wanted_of(site("node = 3", ""), boards)
    assert [one.owner for one in wanted] == ["b1", "sensor"]
    assert missing == ['beacon "b2": its board, node 3, is that of beacon "b1" already']


@pytest.mark.parametrize(
    ("keys", "boards", "said"),
    [
        ("", [Board(A, 3, "beacon", "b1"), Board(B, 4, "beacon", "b1")], 'the name "b1": goldfield nodes name gives'),
        ("group = 2", [], 'no board has the name "b1", nor has it node or board'),
        ("node = 3", [], "no board has the number 3"),
        ("node = 3", [Board(A, 3, "beacon"), Board(B, 3, "beacon")], "the number 3: goldfield nodes assign gives"),
        ("node = 3", [Board(A, 3, "sensor")], "the board with the number 3 is a sensor"),
    ],
)
def test_each_lack_has_its_remedy(site, keys, boards, said):
    _, missing = wanted_of(site(keys), boards)
    assert said in missing[0]


@pytest.mark.parametrize("renew", [False, True])
def test_two_boards_of_one_unique_id_get_no_numbers(renew):
    boards = [Board(A, 3, "beacon"), Board(A, 5, "beacon"), Board(B, 6, "beacon")]
    with pytest.raises(UserError, match=f"2 boards tell the unique id {A}.*leave one of them on the link"):
        assigned(boards, 1, renew=renew)


def test_what_a_board_tells_for_a_name_may_be_anything():
    assert name_of([0x4A325B1B, 0, 0, 0]) == "\x1b[2J"  # It is printed by `printable`.
