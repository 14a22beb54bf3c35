"""`--track` of `goldfield run` and `goldfield locate`."""

import json

import numpy as np
import pytest

from goldfield.cli import main
from goldfield_protocol.parameters import PARAMETERS
from tests.host.fake_sensor import (
    POSITION_M,
    SITE,
    PtySensor,
    beacon_fields,
    log_of,
)

BLOCKS = PARAMETERS["blocks"].first
SIGMA_T = 2e-7 / np.sqrt(1023)


def poses(capsys):
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def table(tmp_path, epochs):
    rng = np.random.default_rng(1)
    rows = ["epoch,t_s,beacon,bx_T,by_T,bz_T"]
    for epoch in epochs:
        noisy = beacon_fields() + SIGMA_T * rng.normal(size=(8, 3))
        rows += [
            f"{epoch},{epoch * 0.1!r},b{place + 1},{x!r},{y!r},{z!r}" for place, (x, y, z) in enumerate(noisy.tolist())
        ]
    path = tmp_path / "fields.csv"
    path.write_text("\n".join(rows))
    return str(path)


def rms_error(lines):
    return np.sqrt(np.mean([np.sum(np.subtract(line["position_m"], POSITION_M) ** 2) for line in lines]))


def test_a_tracked_table_has_the_same_lines_and_less_noise(tmp_path, capsys):
    path = table(tmp_path, range(40))
    assert main(["locate", "--site", str(SITE), "--json", path]) == 0
    alone = poses(capsys)
    assert main(["locate", "--site", str(SITE), "--json", "--track", path]) == 0
    together = poses(capsys)
    assert [list(line) for line in together] == [list(line) for line in alone]
    assert [line["epoch"] for line in together] == list(range(40))
    assert {line["status"] for line in together} == {"ok"}
    assert rms_error(together[3:]) < rms_error(alone[3:])


def test_the_environment_asks_for_tracking_too(tmp_path, capsys, monkeypatch):
    path = table(tmp_path, range(5))
    monkeypatch.setenv("GOLDFIELD_TRACK", "1")
    assert main(["locate", "--site", str(SITE), "--json", path]) == 0
    from_environment = poses(capsys)
    monkeypatch.setenv("GOLDFIELD_TRACK", "0")
    assert main(["locate", "--site", str(SITE), "--json", "--track", path]) == 0
    assert poses(capsys) == from_environment


def test_a_log_is_tracked_over_a_cycle_of_which_nothing_arrived(tmp_path, capsys):
    path = tmp_path / "a.log"
    path.write_text(log_of([3, 4, 5, 6, 7, 9, 10]))
    assert main(["run", "--site", str(SITE), "--log", str(path), "--json", "--track"]) == 0
    lines = poses(capsys)
    assert [line["epoch"] for line in lines] == list(range(3, 11))
    bridged = lines[5]
    assert bridged["used"] == []
    assert bridged["lost"] == 11
    np.testing.assert_allclose(bridged["position_m"], POSITION_M, atol=0.1)
    assert np.trace(bridged["position_cov_m2"]) > np.trace(lines[4]["position_cov_m2"])
    assert {line["status"] for line in lines if line is not bridged} == {"ok"}


def test_a_defect_in_tracking_costs_the_epoch_only(tmp_path, capsys, monkeypatch):
    def broken(*_):
        raise ZeroDivisionError("test")

    monkeypatch.setattr("goldfield.track.filter.Tracker.step", broken)
    assert main(["locate", "--site", str(SITE), "--json", "--track", table(tmp_path, range(2))]) == 0
    captured = capsys.readouterr()
    assert [json.loads(line)["status"] for line in captured.out.splitlines()] == ["failed", "failed"]
    assert captured.err.count("ZeroDivisionError: test") == 2


def test_codes_that_cannot_be_separated_are_one_sentence(tmp_path, capsys):
    """Degree 5: 33 codes and an offset are more than 31 chips can tell apart."""
    text = "[site]\nname = 'small'\nchip_period_s = 1e-4\ndegree = 5\n[sensor]\nnoise_T = 1e-7\n"
    text += "gain_sd = 0.0\naxis_sd_rad = 0.0\n[survey]\nposition_sd_m = 0.0\naxis_sd_rad = 0.0\ncurrent_sd = 0.0\n"
    rows = ["epoch,t_s,beacon,bx_T,by_T,bz_T"]
    moment = np.array([0.0, 0.0, 1.0])
    for code in range(33):
        place = np.array([0.5 * (code % 6), 0.5 * (code // 6), 0.1 * (code % 5)])
        text += f"[[beacon]]\nid = 'x{code}'\nposition_m = {place.tolist()}\naxis = [0.0, 0.0, 1.0]\nturns = 100\n"
        text += f"radius_m = 0.01\ncurrent_A = {1 / (np.pi * 1e-2)!r}\ncode = {code}\n"
        offset = np.array([1.2, 1.3, 1.1]) - place
        distance = np.linalg.norm(offset)
        field = 1e-7 * (3 * offset * (moment @ offset) / distance**2 - moment) / distance**3
        rows.append(f"0,0.0,x{code}," + ",".join(repr(float(value)) for value in field))
    site, path = tmp_path / "site.toml", tmp_path / "fields.csv"
    site.write_text(text)
    path.write_text("\n".join(rows))
    assert main(["locate", "--site", str(site), "--json", str(path)]) == 0
    capsys.readouterr()
    assert main(["locate", "--site", str(site), "--json", "--track", str(path)]) == 2
    error = capsys.readouterr().err
    assert "the 33 codes cannot be separated" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("command", ["run", "locate"])
def test_help_tells_of_it(command, capsys):
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    assert "--track" in capsys.readouterr().out


class BlocksSensor(PtySensor):
    """One that knows ``blocks`` and is configured last with it."""

    def _configured(self):
        return f"get {BLOCKS}" in self.requests and bool(self.parameters[BLOCKS] & 1)


@pytest.mark.parametrize(("before", "after"), [(0, 0), (2, 2), (1, 1), (3, 3)])
def test_tracking_asks_a_live_sensor_for_blocks_on_its_link_and_ends_them(capsys, before, after):
    """What others have on the other link, or had on this one before, stays."""
    parameters = {5: 0, BLOCKS: before, **{256 + i: 0 for i in range(64)}}
    with BlocksSensor(range(1000), parameters=parameters) as sensor:
        assert main(["run", "--site", str(SITE), "--port", sensor.path, "--json", "--track", "--seconds", "0.5"]) == 0
    assert sensor.parameters[BLOCKS] == after
    assert f"get {BLOCKS}" in sensor.requests
    assert (f"set {BLOCKS}" in sensor.requests) == (not before & 1)
    assert [line["status"] for line in poses(capsys)] == ["ok"] * 5
