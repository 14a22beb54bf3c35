"""What the board's own poses cost a turn, and which cycles they answer when time is short: onboard.c by itself."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path

import pytest

from goldfield_protocol import decode
from hil_sim.clib import ROOT

HARNESS = """
#include <string.h>
#include "services/onboard.h"
static onboard_t onboard;
static node_t node;
static epoch_selection_t nothing;
static epoch_calibration_t calibration;
uint32_t sent, identifiers[256], lengths[256];
uint8_t data[256][8];
int32_t node_clamp(int32_t value, int32_t limit) { return value > limit ? limit : value < -limit ? -limit : value; }
void node_send(node_t *n, node_links_t links, uint32_t message, uint32_t index, const uint8_t *bytes, uint8_t length) {
    (void)n; (void)links; (void)index;
    for (uint32_t i = 0; i < length; i++) data[sent][i] = bytes[i];
    lengths[sent] = length;
    identifiers[sent++] = message;
}
void start(void) {
    memset(&onboard, 0, sizeof onboard);
    sent = 0;
    pose_live_forget(&onboard.live);
    onboard.active = onboard.separable = true;
    onboard.chips = 31;
}
void take(uint32_t cycle) {
    const epoch_sums_t sums = {.cycle = cycle, .chips = 31};
    onboard_take(&onboard, &node, &sums, &calibration, &nothing);
}
void step(void) { (void)onboard_step(&onboard, &node); }
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The module, and no beacons."""
    directory = tmp_path_factory.mktemp("onboard")
    source, library = directory / "harness.c", directory / "onboard.so"
    source.write_text(HARNESS)
    core = [str(path) for path in sorted((ROOT / "build/core/firmware").glob("*/*/*.o"))]
    includes = [f"-I{ROOT / path}" for path in ("firmware", "build/protocol")]
    services = ("firmware/services/onboard.c", "firmware/services/pose_report.c")
    sources = [str(ROOT / path) for path in (*services, "build/protocol/goldfield.c")]
    command = ["gcc", "-std=c11", "-shared", "-fPIC", *includes, str(source), *sources, *core, "-o", str(library)]
    subprocess.run(command, check=True)
    return library


@pytest.fixture
def board(library: Path) -> ctypes.CDLL:
    loaded = ctypes.CDLL(str(library))
    loaded.start()
    return loaded


def answers(board: ctypes.CDLL) -> list[tuple[int, int, int]]:
    """(cycle, status, reason) of each answer so far, each of four messages."""
    count = ctypes.c_uint32.in_dll(board, "sent").value
    identifiers, lengths = ((ctypes.c_uint32 * 256).in_dll(board, name) for name in ("identifiers", "lengths"))
    data = (ctypes.c_uint8 * 8 * 256).in_dll(board, "data")
    decoded = [decode(identifiers[i], bytes(data[i][: lengths[i]])) for i in range(count)]
    messages = [message for message in decoded if message is not None]
    found = []
    for i in range(0, count, 4):
        pose = messages[i : i + 4]
        assert [m.name for m in pose] == ["POSE_POSITION", "POSE_ATTITUDE", "POSE_QUALITY", "POSE_INTEGRITY"]
        quality, integrity = pose[2].signals, pose[3].signals
        assert {m.signals["cycle_low"] for m in pose} == {quality["cycle_low"]}
        found.append((int(quality["cycle_low"]), int(quality["status"]), int(integrity["reason"])))
    return found


FEW, LATE, FAILED = 1, 15, 4


def test_a_cycle_that_waits_in_vain_is_answered_as_late(board: ctypes.CDLL) -> None:
    board.take(1)
    board.step()
    board.take(2)
    assert answers(board) == []
    board.take(3)
    assert answers(board) == [(2, FAILED, LATE)]
    for _ in range(4):
        board.step()
    assert answers(board) == [(2, FAILED, LATE), (1, FAILED, FEW), (3, FAILED, FEW)]
    board.step()
    assert len(answers(board)) == 3


def test_without_a_cycle_nothing_is_done(board: ctypes.CDLL) -> None:
    board.step()
    assert answers(board) == []
