"""A calibration is written to a board whole or not at all, whatever comes between."""

from __future__ import annotations

import numpy as np
import pytest

from goldfield.cli import board_calibration
from goldfield.cli.board_calibration import BoardCalibration, write
from goldfield.errors import SystemFailure
from goldfield.link.access import Locked

BEFORE = BoardCalibration(7, "00" * 12, np.array([2048.0, 2049.0, 2050.0]), 1e-7 * np.eye(3))
ZERO, MATRIX = np.array([1.0, 2.0, 3.0]), 2e-7 * (np.eye(3) + 0.1)


class Board:
    """A board whose values can be set; some tries end otherwise."""

    def __init__(self, ends):
        self.values = {(one.identifier(k)): 0.0 for one, k in board_calibration._elements()}
        self.tries, self._ends = 0, ends
        self._fill(BEFORE)

    def _fill(self, calibration):
        numbers = [*calibration.zero, *calibration.matrix.ravel()]
        self.values = dict(zip(self.values, numbers, strict=True))

    def set(self, node, parameter, value, kind):
        assert node == BEFORE.node
        self.tries += 1
        if self.tries in self._ends:
            raise self._ends[self.tries]
        self.values[parameter] = value
        return value

    def numbers(self):
        return list(self.values.values())


@pytest.fixture
def board_of(monkeypatch):
    def made(ends):
        board = Board(ends)
        monkeypatch.setattr(board_calibration.opening, "open_link", lambda *_: None)
        monkeypatch.setattr(board_calibration, "Tap", lambda link, key: Closable())
        monkeypatch.setattr(board_calibration, "Conversation", lambda tap: board)
        return board

    return made


class Closable:
    def close(self):
        pass


def test_all_twelve_numbers_are_written(board_of, capsys):
    board = board_of({})
    write("port", "p", BEFORE, ZERO, MATRIX)
    assert board.numbers() == [*ZERO, *MATRIX.ravel()]
    assert not capsys.readouterr().err


@pytest.mark.parametrize("moment", range(1, 13))
@pytest.mark.parametrize("end", [KeyboardInterrupt(), SystemFailure("node 7 refused")])
def test_what_ends_the_writing_leaves_the_old_calibration(board_of, capsys, moment, end):
    board = board_of({moment: end})
    with pytest.raises(type(end)):
        write("port", "p", BEFORE, ZERO, MATRIX)
    assert board.numbers() == [*BEFORE.zero, *BEFORE.matrix.ravel()]
    assert "node 7 has its old calibration again" in capsys.readouterr().err


@pytest.mark.parametrize("second", [KeyboardInterrupt(), SystemFailure("node 7 did not answer")])
def test_a_board_that_cannot_be_given_its_old_one_is_said(board_of, capsys, second):
    board_of({5: SystemFailure("node 7 did not answer"), 8: second})
    with pytest.raises(SystemFailure, match="did not answer"):
        write("port", "p", BEFORE, ZERO, MATRIX)
    assert "may have part of a new calibration" in capsys.readouterr().err


def test_a_locked_board_was_not_changed_and_is_left_alone(board_of, capsys):
    board = board_of({1: Locked("node 7 is locked")})
    with pytest.raises(Locked):
        write("port", "p", BEFORE, ZERO, MATRIX)
    assert (board.tries, board.numbers()) == (1, [*BEFORE.zero, *BEFORE.matrix.ravel()])
    assert capsys.readouterr().err == ""
