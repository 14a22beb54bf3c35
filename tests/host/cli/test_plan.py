"""``goldfield plan``: its files, its JSON, its refusals, an interrupt."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from goldfield.cli import main
from tests.host.fake_sensor import SITE

BOX = ["--box", "0.3", "0.3", "0.5", "1.8", "1.8", "1.3", "--step", "0.4"]
HERE = ["plan", "--site", str(SITE), *BOX, "--workers", "1"]

LATTICE = """
[lattice]
count = [3, 3]
spacing_m = [1.7, 1.7]
origin_m = [0.8, 0.8]
height_m = 2.7
turns = 19
radius_m = 0.149
current_A = 10.0
[sensor]
noise_T = 2e-8
"""


@pytest.fixture
def lattice(tmp_path):
    path = tmp_path / "lattice.toml"
    path.write_text(LATTICE)
    return path


def test_json_has_median_95_percent_and_worst(capsys):
    assert main([*HERE, "--json"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    summary = json.loads(line)
    assert (summary["points"], summary["beacons"]) == (48, 8)
    for key in ("position_m", "attitude_rad", "protection_m"):
        assert 0.0 < summary[key]["median"] <= summary[key]["p95"] <= summary[key]["worst"]
    assert (summary["ambiguous"], summary["weak"]) == (0.0, 0.0)


def test_files_hold_the_maps(tmp_path, capsys):
    paths = [tmp_path / f"plan.{end}" for end in ("npz", "png", "html")]
    outs = [word for path in paths for word in ("--out", str(path))]
    assert main([*HERE, *outs, "--json"]) == 0
    summary = json.loads(capsys.readouterr().out)
    with np.load(paths[0]) as arrays:
        assert arrays["position_sd_m"].shape == (4, 4, 3)
        assert arrays["position_sd_m"].max() == summary["position_m"]["worst"]
        assert arrays["best"].shape == (4, 4, 3, 8)
        assert arrays["beacon_id"].tolist() == [f"b{i}" for i in range(1, 9)]
    assert paths[1].read_bytes().startswith(b"\x89PNG")
    page = paths[2].read_text()
    assert "default-src 'none'" in page
    assert re.findall(r"(?:src|href)\s*=\s*[\"']?https?:|url\(|import\(|fetch\(", page) == []
    data = json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S).group(1))
    assert data["shape"] == [4, 4, 3]
    assert data["figures"][0]["values"][2] == pytest.approx(100 * summary["position_m"]["worst"])
    before = [path.read_bytes() for path in paths]
    assert main([*HERE, *outs, "--json"]) == 2
    assert "--force" in capsys.readouterr().err
    assert main([*HERE, *outs, "--json", "--force"]) == 0
    assert [path.read_bytes() for path in paths] == before, "the same maps give the same files"


def test_a_floor_plan_lies_beneath(tmp_path, capsys):
    import matplotlib.image

    floor, page = tmp_path / "floor.png", tmp_path / "plan.html"
    matplotlib.image.imsave(floor, np.zeros((4, 6, 3)))
    words = ["--floor", str(floor), "--floor-extent", "-1", "-1", "4", "3"]
    assert main([*HERE, *words, "--out", str(page), "--out", str(tmp_path / "plan.png")]) == 0
    assert '"floor":{"source":"data:image/png;base64,' in page.read_text()
    assert main([*HERE, "--floor", str(SITE)]) == 2
    assert "is neither PNG nor JPEG" in capsys.readouterr().err
    assert main([*HERE, "--floor-extent", "0", "0", "1", "1"]) == 2
    floor.write_bytes(floor.read_bytes()[:60])
    assert main([*HERE, "--floor", str(floor)]) == 2
    assert "the floor plan cannot be read" in capsys.readouterr().err


def test_a_lattice_is_planned_and_improved(lattice, tmp_path, capsys):
    wishes, site = tmp_path / "wishes.toml", tmp_path / "better.toml"
    wishes.write_text('[optimise]\nfigure = "worst"\n[[region]]\nlow_m = [0, 0, 2.7]\nhigh_m = [5, 5, 2.7]\n')
    box = ["--box", "0", "0", "0.6", "5", "5", "1.6", "--step", "1", "--workers", "1"]
    words = ["plan", "--lattice", str(lattice), *box]
    assert main([*words, "--json"]) == 0
    before = json.loads(capsys.readouterr().out)
    assert main([*words, "--optimise", str(wishes), "--site-out", str(site), "--json"]) == 0
    after = json.loads(capsys.readouterr().out)
    assert after["before"] == before
    assert after["target_reached"] is True
    assert after["position_m"]["worst"] < 0.9 * before["position_m"]["worst"]
    assert main(["plan", "--site", str(site), *box, "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["position_m"]["worst"] == pytest.approx(after["position_m"]["worst"], rel=1e-9)


def test_an_optimised_site_file_keeps_what_its_author_wrote(tmp_path, capsys):
    """Comments and the time constant stay; a site whose metal was learned is not moved about."""
    own, wishes, better = tmp_path / "own.toml", tmp_path / "wishes.toml", tmp_path / "better.toml"
    own.write_text("# my hall\n" + SITE.read_text())
    wishes.write_text('[optimise]\nfree = ["position"]\n[[region]]\nlow_m = [-1, -1, -1]\nhigh_m = [4, 4, 4]\n')
    words = ["plan", "--site", str(own), "--box", "0.9", "0.9", "0.9", "1", "1", "1", "--step", "1", "--workers", "1"]
    words += ["--optimise", str(wishes), "--site-out", str(better)]
    assert main(words) == 0
    assert better.read_text().startswith("# my hall\n")
    assert better.read_text() != own.read_text()
    own.write_text(own.read_text().replace("[[beacon]]", "[metal]\nsd_T_A = 1e-10\n\n[[beacon]]", 1))
    capsys.readouterr()
    assert main([*words, "--force"]) == 2
    assert "the site has [metal]" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["plan", "--site", str(SITE), "--step", "1"], "--box or --step is missing"),
        (["plan", *BOX], "--site is missing"),
        ([*HERE, "--lattice", "x.toml"], "--site and --lattice are both given"),
        ([*HERE, "--out", "plan.pdf"], "give one of .npz, .png, .html"),
        ([*HERE, "--out", "/nowhere/plan.npz"], "the folder /nowhere cannot be written"),
        ([*HERE, "--site-out", "x.toml"], "--site-out is given without --optimise"),
        ([*HERE, "--box", "0", "0", "0", "1", "1", "-1"], "--box has its second corner below its first in z"),
        ([*HERE, "--step", "1e-6"], "--step 1e-06 makes"),
        ([*HERE, "--conflict=-1e4"], "--conflict -10000.0 is no ratio of fields: give -1000 to 1000 dB"),
        (["plan", "--lattice", "nowhere.toml", *BOX], "there is no such lattice file"),
    ],
)
def test_refusals_are_one_sentence(words, complaint, capsys):
    assert main(words) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert len(error.splitlines()) == 1


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (("count = [3, 3]", "count = [3, 0]"), ":3: [lattice]: count must be two whole numbers"),
        (("spacing_m = [1.7, 1.7]", "spacing_m = [2.5]"), ":4: [lattice]: spacing_m must be two numbers"),
        (("height_m = 2.7", 'height_m = 2.7\nside = "left"'), 'side is "left"'),
        (("turns = 19", "turn = 19"), 'turn is no known key; did you mean "turns"?'),
        (("noise_T = 2e-8", "noise_T = 2e-8\ndegree = 8"), "degree is 8"),
    ],
)
def test_a_lattice_file_is_checked(change, complaint, lattice, capsys):
    lattice.write_text(LATTICE.replace(*change))
    assert main(["plan", "--lattice", str(lattice), *BOX]) == 2
    assert complaint in capsys.readouterr().err


def test_a_full_disk_leaves_no_half_file(tmp_path, capsys):
    full = tmp_path / "full.npz"
    full.symlink_to("/dev/full")
    assert main([*HERE, "--out", str(full)]) == 3
    assert "No space left on device" in capsys.readouterr().err


def test_an_interrupt_ends_all_processes_and_leaves_no_file(tmp_path):
    out = tmp_path / "plan.npz"
    words = ["plan", "--site", str(SITE), "--box", "0", "0", "0", "9", "9", "9", "--step", "0.05", "--workers", "2"]
    code = (
        "import goldfield.planning.spreading as s, sys\n"
        "from goldfield.cli import main\n"
        "put = s.Figures.put\n"
        "def told(self, *rest):\n"
        "    put(self, *rest)\n"
        "    print('computed', flush=True)\n"
        "s.Figures.put = told\n"
        "if __name__ == '__main__':\n"
        "    sys.exit(main(sys.argv[1:]))\n"
    )
    program = tmp_path / "program.py"
    program.write_text(code)
    process = subprocess.Popen(
        [sys.executable, str(program), *words, "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout.readline() == "computed\n"
    process.send_signal(signal.SIGINT)
    _, error = process.communicate()  # ends when the processes of the pool, which hold stderr too, are gone
    assert process.returncode == 130
    assert "Traceback" not in error
    assert not out.exists()
    assert [path.name for path in Path(tmp_path).iterdir()] == ["program.py"]
