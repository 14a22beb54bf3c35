"""The power goes in each step of an update, and again in the start behind it: a node is never without an image."""

from __future__ import annotations

import pytest

from tests.firmware.core.boot.slots import CONFIRMED, NEW, OK, PENDING, SETTLED, TRIED, Node, PowerLost, running_old
from tests.firmware.core.storage.flash_cells import Torn


def whole_update(node):
    """Bring the new image and let it confirm itself, from the boot of the old one on."""
    for _ in range(3):
        choice, image = node.live()
        if image == NEW:
            return
        assert node.update(NEW, choice.slot) == OK
    raise AssertionError("the update does not come to an end")


def steps_of(core, other):
    node = running_old(core, other=other)
    whole_update(node)
    return node.steps


def judge(node, case):
    """Boot several times: an image is there each time, and the new one never goes again once it is confirmed."""
    seen = []
    for _ in range(4):
        choice, image = node.live()
        assert image is not None, case
        assert node.check(choice.slot) == OK, case
        seen.append(image == NEW)
    assert seen == sorted(seen), (case, seen)


def cut_nodes(core, torn, seeds, other):
    """Yield nodes that lost their power in each step of an update, with an id."""
    for cut in range(steps_of(core, other)):
        for seed in range(seeds):
            node = running_old(core, seed, other)
            node.cut, node.torn = cut, torn
            with pytest.raises(PowerLost):
                whole_update(node)
            yield node, f"cut {cut}, seed {seed}"


def judge_with_second_cuts(core, node, torn, case):
    """Let the power go once more at each step of the start behind the loss, and judge. Returns how many cases."""
    for again in range(12):
        other = Node(core, 99 + again)
        other.torn = torn
        node.cells.copy_to(other.cells)
        other.cut = again
        try:
            other.live()
            whole = True
        except PowerLost:
            whole = False
        other.cut = None
        judge(other, f"{case}, again {again}")
        whole_update(other)
        assert other.live()[1] == NEW
        if whole:
            return again + 1
    raise AssertionError("a start takes more steps than any")


def test_an_update_has_the_steps_that_it_should(core):
    node = running_old(core)
    whole_update(node)
    erased = [place for place, (_, index, _) in enumerate(node.log) if index is None]
    assert erased == [2]  # Behind the two words that make void what lies there.
    assert node.log[-8][1:] == (0, 8)
    assert [index for _, index, _ in node.log[-8:]] == [0, 1, 2, PENDING, PENDING, TRIED, CONFIRMED, SETTLED]
    assert {slot for slot, _, _ in node.log} == {1}
    assert node.steps == 3 + 16 + 1 + 16 + len(NEW.code) - 1 + 8


@pytest.mark.parametrize("other", [True, False], ids=["an image before", "an empty slot"])
@pytest.mark.parametrize("torn", Torn)
def test_an_image_starts_whenever_the_power_goes(core, torn, other):
    cases = 0
    for node, case in cut_nodes(core, torn, 3, other):
        cases += judge_with_second_cuts(core, node, torn, f"{torn.name}, {case}")
    print(f"{torn.name}: {cases} losses of power and second losses, 0 nodes without an image")
    assert cases > 3 * 40
