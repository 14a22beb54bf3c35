"""Fake boards (fake_board.c) and small scenarios for tests of the rig."""

from __future__ import annotations

import textwrap
from functools import cache
from pathlib import Path
from typing import Any

import cffi
import numpy as np
from numpy.typing import NDArray

from hil_sim import scenario
from hil_sim.rig.boards import Board, BoardSpec, address
from tests.objects import shared_library

HERE = Path(__file__).parent


@cache
def library() -> tuple[cffi.FFI, Any]:
    """Compile the fake board once and open it."""
    ffi = cffi.FFI()
    ffi.cdef(
        """
        typedef struct {
            bool drives, senses, still; unsigned periods; double ppm; uint32_t can_id; int64_t stops_at_ps;
        } fake_config_t;
        typedef struct { int64_t time_ps; double volts[3]; } fake_sample_t;
        size_t fake_samples(const void *board, const fake_sample_t **samples);
        void *fake_create(const fake_config_t *config, const void *edge, int64_t power_on_ps);
        extern const char fake_operations[];
        """
    )
    return ffi, ffi.dlopen(str(shared_library(HERE / "fake_board.c")))


class FakeBoards:
    """A factory of fake boards.

    Parameters
    ----------
    still : bool
        Beacons keep a constant current.
    stops : dict, optional
        Board number to the time at which it stops, picoseconds.
    periods : dict, optional
        Board number to its turns in a cycle: it drives two coils.
    """

    def __init__(
        self, *, still: bool = False, stops: dict[int, int] | None = None, periods: dict[int, int] | None = None
    ) -> None:
        self._still, self._stops, self._periods = still, stops or {}, periods or {}
        self.instances: list[int] = []

    def __call__(self, spec: BoardSpec, edge: int) -> Board:
        ffi, lib = library()
        config = ffi.new("fake_config_t *")
        config.drives, config.senses = spec.role != "sensor", spec.role != "beacon"
        config.still, config.ppm = self._still, spec.clock.crystal_ppm
        config.periods = self._periods.get(len(self.instances), 0)
        config.can_id = 0x01000001 + len(self.instances)
        config.stops_at_ps = self._stops.get(len(self.instances), 0)
        instance = lib.fake_create(config, ffi.cast("void *", edge), spec.power_on_ps)
        self.instances.append(address(ffi, instance))
        return Board(self.instances[-1], address(ffi, lib.fake_operations), destroy=lambda: None)

    def samples(self, board: int) -> NDArray[Any]:
        """What a board has converted so far: a structured array of ``time_ps, volts``."""
        ffi, lib = library()
        where = ffi.new("fake_sample_t **")
        count = lib.fake_samples(ffi.cast("void *", self.instances[board]), where)
        layout = np.dtype([("time_ps", "i8"), ("volts", "f8", 3)])
        return np.frombuffer(bytes(ffi.buffer(where[0], count * layout.itemsize)), dtype=layout)


SMALL = """
    name = "small"
    seed = 7
    power_on_spread_s = 1e-3

    [ambient]
    earth_T = [2e-5, 0.0, -4.5e-5]

    [sensor]
    node = 100
    range_T = 2e-4
    noise_T = 1e-7
    bandwidth_Hz = 1e5
    crystal_ppm = 20.0

    [motion]
    kind = "still"
    position_m = [0.5, 0.6, 0.4]
    rotation_vector_rad = [0.1, -0.2, 0.3]

    [coil]
    turns = 19
    radius_m = 0.149
    axis = [0.0, 0.0, 1.0]
    current_A = 10.0
    inductance_H = 1.9e-4
    resistance_Ohm = 0.15
    supply_V = 120.0

    [[beacon]]
    id = "a"
    node = 1
    code = 2
    position_m = [0.0, 0.0, 0.0]
    sync_master = true

    [[beacon]]
    id = "b"
    node = 2
    code = 3
    position_m = [1.0, 0.0, 0.0]
    crystal_ppm = 40.0

    [[beacon]]
    id = "c"
    node = 3
    code = 4
    position_m = [0.0, 1.0, 0.0]
    crystal_ppm = -30.0
    """


def write_scenario(directory: Path, **replacements: str) -> Path:
    """Write the small scenario with replacements: the first line that sets a key gets the value (or more lines)."""
    text = textwrap.dedent(SMALL)
    for old, new in replacements.items():
        lines = text.splitlines()
        places = [number for number, line in enumerate(lines) if line.split("=")[0].strip() == old]
        lines[places[0]] = f"{old} = {new}"
        text = "\n".join(lines) + "\n"
    path = directory / "small.toml"
    path.write_text(text)
    return path


def small(directory: Path, **replacements: str) -> scenario.Scenario:
    """Load the small scenario with replacements."""
    return scenario.load(write_scenario(directory, **replacements))
