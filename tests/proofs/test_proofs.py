"""What is proven stays proven; and no proof holds of code that is wrong: one that cannot fail proves nothing."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from hil_sim.clib import ROOT
from tests.proofs.kept import proven
from tests.proofs.loops import Source
from tests.proofs.parts import read_parts
from tests.proofs.run import behaves, prove

PARTS = {part.name: part for part in read_parts()}
LEAST_COVERED = 95.0
"""Statements that the harnesses reach, percent: the others are in no state's way, or of kinds that no parameter has."""

BUGS = [
    ("frame", "link/frame.c", "decoder->pending < sizeof decoder->bytes", "decoder->pending <= sizeof decoder->bytes"),
    ("frame", "link/frame.c", "frame->length > FRAME_DATA_MAX", "frame->length > FRAME_DATA_MAX + 1u"),
    ("frame", "link/frame.c", "    memset(frame->data, 0, sizeof frame->data);\n", ""),
    ("frame", "link/frame.c", "length < HEAD + CHECK", "length < CHECK"),
    ("queue", "link/queue.c", "head & (queue->capacity - 1u)] =", "head & queue->capacity] ="),
    ("queue", "link/queue.c", "tail & (queue->capacity - 1u)]", "tail & queue->capacity]"),
    ("parameters", "link/parameters.c", "column < entry->elements", "column <= entry->elements"),
    ("parameters", "link/parameters.c", "count > (size - HEADER) / ENTRY", "count > size / ENTRY"),
    ("parameters", "link/parameter_set.c", "index + 1u < count", "index < count"),
    ("storage", "storage/store.c", "end <= store->flash.words ?", "end <= store->flash.words + 1u ?"),
    (
        "storage",
        "storage/store.c",
        "words[end - END_WORDS] ==",
        "words[index + (words[index] & COUNT_MASK) + AROUND_DATA] ==",
    ),
    (
        "storage",
        "storage/store.c",
        "RECORD_EXTRA <= store->flash.words",
        "RECORD_EXTRA <= store->flash.words + 1u",
    ),
    ("storage", "storage/store.c", "end <= count + 1u", "end <= count + 2u"),
    ("storage", "storage/store.c", "while (found.behind > 0u && ", "while ("),
    ("boot", "boot/image.c", "bytes > (flash->words - IMAGE_CODE)", "bytes > (flash->words - IMAGE_CODE + 1u)"),
    ("boot", "boot/image.c", "HEADER_BYTES + bytes", "HEADER_BYTES + header->bytes"),
    ("boot", "boot/select.c", "select->place < IMAGE_SLOTS ?", "select->place <= IMAGE_SLOTS ?"),
    ("boot", "boot/select.c", "    select->place++;\n", ""),
    ("update", "boot/install.c", "index < install->words;", "index <= install->words;"),
    ("update", "boot/install.c", "install->cursor == steps", "install->cursor > steps"),
]
"""Part, file, and what becomes of what: bounds that are off by one, readings once too often, ends that do not come."""


@pytest.mark.parametrize("name", PARTS)
def test_what_is_proven_stays_proven(name: str) -> None:
    """There is no alarm, no unknown wrap and none that is known and is not there, and the harness reaches the code."""
    outcome = proven(PARTS[name])
    assert outcome.alarms == []
    assert outcome.covered() >= LEAST_COVERED


def with_bug(tree: Path, file: str, right: str, wrong: str) -> None:
    """Copy what the proofs read of the firmware, with one change."""
    for folder in ("core", "third_party"):
        shutil.copytree(ROOT / "firmware" / folder, tree / folder)
    path = tree / "core" / file
    text = path.read_text()
    assert text.count(right) == 1
    path.write_text(text.replace(right, wrong))


FIRST = {name: bug for name, *bug in reversed(BUGS)}
"""The first bug of each part; the others are looked at by the slow tests, and by ``make test-slow`` with them."""


@pytest.mark.parametrize(
    ("name", "file", "right", "wrong"),
    [pytest.param(name, *bug, marks=[] if FIRST[name] == bug else pytest.mark.slow) for name, *bug in BUGS],
)
def test_no_proof_holds_of_a_bug(tmp_path: Path, name: str, file: str, right: str, wrong: str) -> None:
    """The first run of the part alone finds it."""
    with_bug(tmp_path, file, right, wrong)
    part = PARTS[name]
    assert behaves(replace(part, runs=part.runs[:1]), tmp_path).alarms != []


def test_every_part_has_a_bug() -> None:
    """A part without one may have a harness that proves nothing."""
    assert {name for name, *_ in BUGS} == set(PARTS)


def test_a_wrap_that_is_not_known_is_told(tmp_path: Path) -> None:
    """So is one that is known and is not there."""
    queue = PARTS["queue"]
    with_bug(tmp_path, "link/queue.c", "lost < UINT32_MAX ? lost + 1u : lost", "lost + 1u")
    assert any("lost + 1u" in each for each in prove(queue, tmp_path).alarms)
    assert (
        prove(replace(queue, wraps=(*queue.wraps, replace(queue.wraps[0], what=("tail - 1u",)))), tmp_path)
        .alarms[-1]
        .endswith("is not there")
    )


LOOPS = """
void a(const int *n, int *m, int k) {
    for (int i = 0; i < k; i++) { m[i] = 0; }
    for (int i = 0; i < 3 && m[i]; i++) { m[0]++; }
    for (int i = 0; i < n->words; i++) { }
    for (int i = 0; i < m->words; i++) { }
    for (int i = 0; i < k; i++) { k++; }
    for (int i = 0; i < k; i++) { i--; }
    for (int i = 0; i < k; i++) { b(&i); }
    for (int i = 0; i != k; i++) { }
    for (int i = 0; i < k; m++) { }
    while (k > 0) { k--; }
}
"""


def test_which_loops_count(tmp_path: Path) -> None:
    """Those in which nothing but the head changes the number, and nothing the bound."""
    path = tmp_path / "loops.c"
    path.write_text(LOOPS)
    source = Source(path)
    assert [source.counts(line) for line in range(3, 13)] == [True, True, True, *[False] * 7]
    assert source.functions == {"a"}
    assert source.function_at(3) == "a"
