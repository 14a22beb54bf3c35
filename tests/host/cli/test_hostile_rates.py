"""Recordings with blocks as nobody made them, at a rate: each is told of in a sentence, and no pose comes twice."""

import json

import numpy as np
import pytest

import goldfield
from goldfield.cli import main
from goldfield_protocol import decode, encode
from tests.host.fake_sensor import CYCLE_S, NODE, POSITION_M, SITE, block_messages, candump, cycle_messages, heartbeat

BLOCK_S = CYCLE_S / 33
FIRST, COUNT = 30, 8


def recorded(cycles=range(FIRST, FIRST + COUNT)):
    """Return (time, message) pairs: each block at its end, each cycle behind its last one."""
    messages = [(FIRST * CYCLE_S, heartbeat())]
    for cycle in cycles:
        for number, block in enumerate(block_messages(cycle)):
            messages += [(cycle * CYCLE_S + (number + 1) * BLOCK_S, message) for message in block]
        messages += [((cycle + 1) * CYCLE_S + 1e-3, message) for message in cycle_messages(cycle)]
    return messages


@pytest.fixture(scope="module")
def whole():
    return recorded()


def kind(message):
    return decode(*message).name


def changed(message, name, index=None, **signals):
    """Return a message of a name with other signals or another index; others as they are."""
    told = decode(*message)
    if told.name != name:
        return message
    return encode(name, dict(told.signals) | signals, node=NODE, index=told.index if index is None else index)


def written(tmp_path, messages):
    log = tmp_path / "a.log"
    log.write_text(candump(messages))
    return log


def run(capsys, tmp_path, messages, *options):
    log = written(tmp_path, messages)
    code = main(["run", "--site", str(SITE), "--log", str(log), "--json", *options])
    captured = capsys.readouterr()
    return code, [json.loads(line) for line in captured.out.splitlines()], captured.err


def sound(lines):
    """Tell whether each pose comes once, in the order of time, and lies where the sensor is."""
    times = [line["t_s"] for line in lines]
    far = [np.linalg.norm(np.subtract(line["position_m"], POSITION_M)) for line in lines]
    return (np.diff(times) > 0.0).all() and max(far) < 0.12


def test_a_recording_with_blocks_has_a_pose_for_each(capsys, tmp_path, whole):
    code, lines, said = run(capsys, tmp_path, whole, "--rate", "330")
    assert (code, len(lines)) == (0, 33 * COUNT)
    assert sound(lines)
    assert "no blocks" not in said


@pytest.mark.parametrize("rate", ["330", "100"])
def test_blocks_of_a_longer_code_are_ignored(capsys, tmp_path, whole, rate):
    """They ended the run before: chip= of Block is 1500."""
    blocks = [place for place, (_, message) in enumerate(whole) if kind(message) == "BLOCK"]
    messages = list(whole)
    for place in blocks[40:43]:
        time_s, message = messages[place]
        messages[place] = time_s, changed(message, "BLOCK", index=1023 + 31)
    code, lines, said = run(capsys, tmp_path, messages, "--rate", rate)
    assert code == 0
    assert sound(lines)
    assert len(lines) == pytest.approx(COUNT * CYCLE_S * float(rate), abs=1.5), "what is left out is bridged"
    assert "3 blocks of chips lost" in said


@pytest.mark.parametrize("rate", ["330", "100"])
def test_blocks_without_data_give_each_pose_once(capsys, tmp_path, whole, rate):
    """Every further one gave the poses of those before it again."""
    messages, blocks = [], 0
    for time_s, message in whole:
        blocks += kind(message) == "BLOCK"
        if 40 <= blocks < 46:
            message = changed(message, "BLOCK", x=-262144 * 8e-10, y=-262144 * 8e-10, z=-262144 * 8e-10)
        messages.append((time_s, message))
    code, lines, _ = run(capsys, tmp_path, messages, "--rate", rate)
    assert code == 0
    assert sound(lines)
    assert len(lines) == pytest.approx(COUNT * CYCLE_S * float(rate), abs=1.5)


@pytest.mark.parametrize("back_s", [2.0, -2.0])
def test_a_clock_that_jumps_does_not_mean_that_no_blocks_come(capsys, tmp_path, whole, back_s):
    messages = []
    for time_s, message in whole:
        told = decode(*message)
        if told.name == "EPOCH" and told.signals["cycle"] >= FIRST + COUNT // 2:
            message = changed(message, "EPOCH", time=told.signals["time"] + back_s)
        messages.append((time_s, message))
    code, lines, said = run(capsys, tmp_path, messages, "--rate", "330")
    assert code == 0
    assert len(lines) > 30 * COUNT
    assert "no blocks of chips come" not in said


def test_that_no_blocks_come_is_said_at_once_and_where_they_end(capsys, tmp_path, whole):
    sums = ("BLOCK", "BLOCK_SUM")
    none = [(time_s, message) for time_s, message in whole if kind(message) not in sums]
    code, lines, said = run(capsys, tmp_path, none[: len(none) // 8], "--rate", "330")
    assert (code, len(lines)) == (0, 1)
    assert "no blocks of chips come: there is one pose a cycle" in said
    later = recorded(range(FIRST, FIRST + 20))
    begun = [(time_s, message) for time_s, message in later if time_s < 3.2 or kind(message) not in sums]
    code, lines, said = run(capsys, tmp_path, begun, "--rate", "330")
    assert code == 0
    assert "no blocks of chips come: there is one pose a cycle" in said


@pytest.mark.parametrize("options", [["--rate", "100"], ["--rate", "330"], []])
def test_poses_with_a_lag_of_every_third_block(capsys, tmp_path, whole, options):
    """There were none but where a pose was due at the very end of a block."""
    messages, blocks = [], 0
    for time_s, message in whole:
        name = kind(message)
        blocks += name == "BLOCK"
        if name not in ("BLOCK", "BLOCK_SUM") or blocks % 3 == 1:
            messages.append((time_s, message))
    code, lines, _ = run(capsys, tmp_path, messages, "--lag", *options)
    rate = float(options[1]) if options else 1.0 / CYCLE_S
    assert code == 0
    assert sound(lines)
    assert len(lines) == pytest.approx(COUNT * CYCLE_S * rate, abs=3.5)


def test_a_run_without_a_pose_says_so(capsys, tmp_path, whole):
    code, lines, said = run(capsys, tmp_path, whole, "--rate", "1e-9")
    assert (code, lines) == (0, [])
    assert said == "0 poses: none\n"


@pytest.mark.parametrize("rate", [0, -1.0, np.nan, np.inf, 1e9, 10**400, "330", [330.0]])
def test_a_rate_that_is_none_is_told_in_a_sentence(tmp_path, whole, rate):
    with pytest.raises(goldfield.UserError, match=r"rate_hz=: .* Hz is not above 0 and at most 10000 Hz"):
        goldfield.open_log(written(tmp_path, whole), site=goldfield.load_site(SITE), rate_hz=rate)


@pytest.mark.parametrize("ahead_s", [np.nan, np.inf, -np.inf, 60.1, -60.1, 1e300])
def test_a_time_that_is_far_from_all_blocks_is_told_in_a_sentence(tmp_path, whole, ahead_s):
    with goldfield.open_log(
        written(tmp_path, whole), site=goldfield.load_site(SITE), rate_hz=np.float32(330)
    ) as sensor:
        pose = next(sensor.poses())
        assert sensor.pose_at(pose.time_s + 59.9).status is not goldfield.Status.OK
        with pytest.raises(goldfield.UserError, match="ask for a time within 60 s of it"):
            sensor.pose_at(pose.time_s + ahead_s)
        assert sensor.pose_at(pose.time_s + 0.005).time_s == pose.time_s + 0.005
