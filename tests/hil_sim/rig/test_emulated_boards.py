"""What only emulated boards can show: how a rig makes them, and what happens to their crystals and supplies."""

import pytest

from goldfield.errors import SystemFailure, UserError
from goldfield.update import program_board
from goldfield_protocol import decode, encode
from goldfield_protocol.image import KEY_PLACE, SLOTS
from hil_sim import scenario
from hil_sim.emulator import Configuration
from hil_sim.emulator.kept_flash import CELLS, FLASH
from hil_sim.rig import Rig
from hil_sim.rig.boards import FLASHED, EmulatedBoards
from tests.hil_sim.rig.fakes import FakeBoards, small, write_scenario

KEY = "0123456789abcdef" * 4


@pytest.mark.parametrize(
    "key",
    [
        *("crystal_dead = true", "crystal_stops_s = 0.1", "crystal_ppm_per_s = 0.1", "temperature_K_per_s = 0.1"),
        *("processor_supply_V = 3.2", 'flash = "sensor.flash"', f'public_key = "{KEY}"'),
    ],
)
def test_host_boards_refuse_what_they_cannot_follow(tmp_path, key):
    with pytest.raises(UserError, match=f"host boards cannot simulate {key.split()[0]}: use --boards emulated"):
        Rig(small(tmp_path, crystal_ppm=f"20.0\n{key}"), "host")


def with_tables(directory, text, **replacements):
    path = write_scenario(directory, **replacements)
    path.write_text(path.read_text() + text)
    return scenario.load(path)


SAG = '[[event]]\ntime_s = 0.02\nbeacon = "a"\nprocessor_supply_V = {}\n'


def test_host_boards_refuse_an_event_that_they_cannot_follow(tmp_path):
    with pytest.raises(UserError, match="beacon a is no emulated board: it has neither a crystal nor a supply"):
        Rig(with_tables(tmp_path, SAG.format(2.0)), "host")


def test_boards_have_the_option_bytes_that_a_probe_leaves():
    assert Configuration().option_bytes & ~program_board.BROWN_OUT == FLASHED != Configuration().option_bytes


def test_a_processor_whose_supply_sags_by_scenario_is_reset_until_it_is_back(tmp_path):
    """Level 3 of the brown-out reset is 2.83 V falling and 2.92 V rising (DS8626, table 19)."""
    with Rig(with_tables(tmp_path, SAG.format(2.84)), "emulated") as rig:
        assert ran(rig, 0.02) > ran(rig, 0.01) > 1000
    with Rig(with_tables(tmp_path, SAG.format(2.82)), "emulated") as rig:
        assert ran(rig, 0.02) > 1000 > ran(rig, 0.01)
        rig.supply(1, 2.91)
        assert ran(rig, 0.01) == 0
        rig.supply(1, 2.93)
        assert ran(rig, 0.01) > 1000
        assert rig.statistics(1)["violations"] == 0


def ran(rig, seconds):
    """How many instructions beacon a executes in this time."""
    before = rig.statistics(1)["instructions"]
    rig.advance(seconds)
    return rig.statistics(1)["instructions"] - before


def as_from_the_factory():
    return EmulatedBoards(option_bytes=Configuration().option_bytes)


def test_a_processor_that_no_probe_has_programmed_errs_where_its_supply_sags(tmp_path):
    """Below 2.7 V 168 MHz need more wait states than there are, which stops the board: nothing resets it."""
    with Rig(with_tables(tmp_path, SAG.format(2.72)), as_from_the_factory()) as rig:
        rig.advance(0.03)
        assert rig.statistics(1)["violations"] == 0
    with Rig(with_tables(tmp_path, SAG.format(2.68)), as_from_the_factory()) as rig:
        rig.advance(0.02)
        with pytest.raises(SystemFailure, match=r"beacon a stopped(.|\n)*too few wait states"):
            rig.advance(0.01)


def test_a_processor_has_its_own_supply_by_scenario(tmp_path):
    """Too little from the start, and a little less than nominal."""
    keys = {"crystal_ppm": "20.0\nprocessor_supply_V = {}"}
    with Rig(small(tmp_path, crystal_ppm=keys["crystal_ppm"].format(2.72)), as_from_the_factory()) as rig:
        rig.advance(0.02)
    with (
        Rig(small(tmp_path, crystal_ppm=keys["crystal_ppm"].format(2.68)), as_from_the_factory()) as rig,
        pytest.raises(SystemFailure, match=r"the sensor stopped(.|\n)*too few wait states"),
    ):
        rig.advance(0.02)


def test_a_bus_with_wrong_bits_by_scenario(tmp_path):
    """A frame of some 128 bits, 1e-3 of which are wrong, is destroyed one time in eight; without the table never."""
    destroyed = []
    for text in ("", "[can]\nbit_error_probability = 1e-3\n"):
        with Rig(with_tables(tmp_path, text), FakeBoards()) as rig:
            rig.advance(0.15)
            counts = rig.can_statistics()
            destroyed.append(counts["errors"] / counts["frames"])
    assert destroyed[0] == 0.0
    assert 0.07 < destroyed[1] < 0.2


MARK = 0xC0000
"""A byte of sector 10, in which there is neither image nor parameter page."""


def marked(cells):
    assert cells[MARK] == 0xFF
    return cells[:MARK] + b"\x5a" + cells[MARK + 1 :]


def test_a_power_cycle_leaves_the_flash(tmp_path):
    with Rig(small(tmp_path), "emulated") as rig:
        rig.advance(0.05)
        cells = marked(rig._boards[0].cells())
        rig._boards[0].cells = lambda: cells
        rig.power_cycle_sensor(0.01)
        rig.advance(0.05)
        assert rig._boards[0].cells() == cells
        assert rig._boards[1].cells()[MARK] == 0xFF


def test_a_file_keeps_the_flash_of_its_board(tmp_path):
    path = tmp_path / "sensor.flash"
    scene = small(tmp_path, crystal_ppm=f'20.0\nflash = "{path}"')
    with Rig(scene, "emulated") as rig:
        rig.advance(0.02)
    assert len(path.read_bytes()) == CELLS
    path.write_bytes(marked(path.read_bytes()))
    with Rig(scene, "emulated") as rig:
        rig.advance(0.02)
        assert rig._boards[0].cells()[MARK] == 0x5A
        assert rig._boards[1].cells()[MARK] == 0xFF


@pytest.mark.parametrize("known", [True, False])
def test_a_board_with_a_public_key_has_a_boot_loader_and_may_be_updated(tmp_path, known):
    """Command 15 tells the running slot, the state of its image (3 confirmed), and whether there is a key."""
    key = f'\npublic_key = "{KEY}"' if known else ""
    with Rig(small(tmp_path, crystal_ppm=f"20.0{key}"), "emulated") as rig:
        rig.advance(0.3)
        (answer,) = answers(rig, "COMMAND_ANSWER", 15, {"board": 0, "argument": 0})
        place = KEY_PLACE - FLASH.start
        cells = rig._boards[0].cells()
    assert (answer["status"], answer["value"]) == (0, 3 << 4 | known << 12)
    assert (cells[place + 4 : place + 36] == bytes.fromhex(KEY)) == known


def answers(rig, name, index, values):
    """Give the sensor a command on CAN, and return what it answers within 20 ms."""
    rig.can_read()
    rig.can_write(*encode("COMMAND", values, node=100, index=index))
    rig.advance(0.02)
    told = [decode(frame.identifier, frame.data) for frame in rig.can_read()]
    return [one.signals for one in told if one is not None and one.name == name and one.node == 100]


@pytest.mark.slow  # by default tests/host/update/test_flash_on_the_emulated_chip.py empties a slot of the chip
def test_a_board_empties_its_slot_amid_the_traffic_of_its_bus(tmp_path):
    """The processor stands still for 2.5 s; frames that ran over would be a violation, which ends a board."""
    with Rig(small(tmp_path, crystal_ppm=f'20.0\npublic_key = "{KEY}"'), "emulated") as rig:
        rig.advance(0.5)
        halves = [int(one["half"]) for one in answers(rig, "IDENTITY", 0, {"board": 0, "argument": 0})]
        board = halves[0] ^ halves[1]
        answers(rig, "COMMAND_ANSWER", 10, {"board": board, "argument": 17_800})
        rig.advance(4.0)
        told = [decode(frame.identifier, frame.data) for frame in rig.can_read()]
        begun = [one.signals for one in told if one is not None and (one.name, one.index) == ("COMMAND_ANSWER", 10)]
        assert [(one["status"], one["value"]) for one in begun] == [(0, SLOTS[1])]
        assert len([one for one in told if one is not None and one.name == "SYNC"]) > 30


def test_host_boards_count_no_cycles(tmp_path):
    with pytest.raises(UserError, match="host boards count no cycles: leave out --cycles-per-instruction"):
        Rig(small(tmp_path), "host", cycles_per_instruction=1.5)


def test_fake_boards_have_no_crystal(tmp_path):
    with Rig(small(tmp_path), FakeBoards()) as rig, pytest.raises(UserError, match="beacon a is no emulated board"):
        rig.crystal(1, False)


def test_a_slower_core_sleeps_less(tmp_path):
    """Boot and a first block, at 2 and at 3 cycles an instruction: 1 is what `--cycles-per-instruction` replaces."""
    shares = []
    for cycles in (2.0, 3.0):
        with Rig(small(tmp_path), "emulated", cycles_per_instruction=cycles) as rig:
            rig.advance(0.05)
            shares.append(rig.statistics(1)["sleep_share"])
    assert shares[0] > shares[1]


@pytest.mark.parametrize("by_scenario", [True, False])
def test_a_crystal_stops_while_the_board_runs(tmp_path, by_scenario):
    """The firmware notices, and starts its PLL anew from the internal oscillator, which takes a third of a millisecond.

    Unnoticed, the clock would be a twentieth of 168 MHz.
    """
    keys = {"crystal_ppm": "20.0\ncrystal_stops_s = 0.02"} if by_scenario else {}
    with Rig(small(tmp_path, **keys), "emulated") as rig:
        board = 0 if by_scenario else 1
        rig.advance(0.02)
        if not by_scenario:
            rig.crystal(board, False)
        before = rig.statistics(board)["cycles"]
        rig.advance(0.01)
        cycles = rig.statistics(board)["cycles"] - before
    assert 168e6 * (0.01 - 5e-4) < cycles < 168e6 * 0.01


def test_frames_are_destroyed_as_many_as_asked(tmp_path):
    """A destroyed frame reaches nobody; fake boards, which count no errors, learn that theirs failed."""
    with Rig(small(tmp_path), FakeBoards()) as rig:
        rig.advance(0.005)
        before = len(rig.can_read())
        rig.can_corrupt(2)
        rig.can_delay(2e-7)
        rig.advance(0.005)
        counts = rig.can_statistics()
        assert counts["errors"] == 2
        assert before + len(rig.can_read()) == counts["frames"] - 2
        with pytest.raises(UserError, match="0 to below 1"):
            rig.can_errors(1.0)
        with pytest.raises(UserError, match="0 to 1 us, not 2 us"):
            rig.can_delay(2e-6)


def test_the_hosts_frames_are_sent_again(tmp_path):
    with Rig(small(tmp_path), FakeBoards()) as rig:
        rig.advance(0.005)
        rig.can_read()
        rig.can_corrupt(5)  # The host's has the lowest identifier: it is among them.
        rig.can_write(1, b"host")
        rig.advance(0.005)
        assert [frame.data for frame in rig.can_read() if frame.board == rig.host_node] == [b"host"]


def test_a_bus_that_delays_by_scenario(tmp_path, monkeypatch):
    """What a delay does to the boards' clocks, tests of CAN timing show; here it only has to arrive."""
    told = []
    monkeypatch.setattr(Rig, "can_delay", lambda self, seconds: told.append(seconds))
    with Rig(with_tables(tmp_path, "[can]\ndelay_s = 2e-7\n"), FakeBoards()):
        assert told == [2e-7]
