"""The wheel, installed alone in a fresh environment and used outside the tree, with no compiler on the path.

The environment gets the packages that goldfield depends on as links to those of the project's own environment, and
nothing of the checkout.
"""

import json
import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from goldfield_protocol import protocol_hash
from hil_sim.clib import LIBRARIES, ROOT
from tests.host.fake_sensor import ATTITUDE, POSITION_M, SITE, beacon_fields, heartbeat, log_of

pytestmark = pytest.mark.slow

IMAGES = ("beacon", "sensor", "anchor")
KERNEL = "goldfield/locate/kernel/built/libgf_locate.so"
BANK = "goldfield/track/blocks/kernel/built/libgf_bank.so"
VERSION_H = ROOT / "firmware" / "services" / "version.h"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Return the wheel, built of the libraries and images that ``make`` has made."""
    directory = tmp_path_factory.mktemp("wheel")
    pip = [
        sys.executable,
        "-m",
        "pip",
        "--disable-pip-version-check",
        "wheel",
        "-q",
        "--no-deps",
        "--no-build-isolation",
    ]
    subprocess.run(
        [*pip, "--wheel-dir", directory, ROOT],
        env={**os.environ, "GOLDFIELD_PARTS": str(ROOT / "build")},
        check=True,
        capture_output=True,
    )
    (path,) = directory.glob("*.whl")
    print(f"\n{path.name}: {path.stat().st_size / 1e6:.2f} MB")
    return path


class Installation:
    """A Python environment with the wheel in it, and a directory of its own to work in."""

    def __init__(self, directory, wheel):
        self.home = directory / "home"
        self.home.mkdir()
        environment = directory / "environment"
        venv.create(environment, with_pip=False)
        self.programs = environment / "bin"
        paths = {"base": str(environment), "platbase": str(environment)}
        self.packages = Path(sysconfig.get_path("purelib", "venv", vars=paths))
        for path in Path(sysconfig.get_path("purelib")).iterdir():
            if "goldfield" not in path.name and path.suffix != ".pth" and path.name != "__pycache__":
                (self.packages / path.name).symlink_to(path)
        pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", self.programs / "python"]
        subprocess.run([*pip, "install", "-q", "--no-index", "--no-deps", wheel], check=True, capture_output=True)
        subprocess.run([*pip, "check"], check=True, capture_output=True)

    def run(self, program, *arguments, code=0):
        """Run a program of the environment there; return what it printed to stdout and stderr."""
        done = subprocess.run(
            [self.programs / program, *map(str, arguments)],
            cwd=self.home,
            env={"PATH": str(self.programs), "HOME": str(self.home), "LANG": "C.UTF-8"},
            capture_output=True,
            text=True,
        )
        assert done.returncode == code, done.stderr
        return done.stdout, done.stderr

    def write(self, name, text):
        """Write a file in the directory and return its path."""
        path = self.home / name
        path.write_text(text)
        return path


@pytest.fixture(scope="module")
def installation(tmp_path_factory, wheel):
    return Installation(tmp_path_factory.mktemp("installation"), wheel)


@contextmanager
def taken_away(path):
    """Rename a file or a folder for a while."""
    aside = path.with_name(f"{path.name}.aside")
    path.rename(aside)
    try:
        yield
    finally:
        aside.rename(path)


def test_the_wheel_holds_everything_but_sources_and_tests(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {KERNEL, BANK, "goldfield_protocol/goldfield.dbc", "hil_sim/scenarios/prigge8.toml"} <= names
    assert "goldfield/page/built/index.html" in names
    assert {Path(name).suffix for name in names if name.startswith("goldfield/page/built/assets/")} >= {".js", ".css"}
    assert not [name for name in names if "page/web" in name]
    assert {f"hil_sim/built/{library}" for library in LIBRARIES} <= names
    assert {f"hil_sim/built/firmware/{slot}{image}.elf" for slot in ("", "slot_b/") for image in IMAGES} <= names
    assert not [name for name in names if name.endswith((".c", ".h", ".mk")) or name.startswith(("tests", "firmware"))]


def test_an_update_file_is_made_of_the_images_in_the_wheel(installation):
    """The command of docs/update.md, with the folder that it names."""
    text = (ROOT / "docs/update.md").read_text()
    assert "the installed package hil_sim, in its folders built/firmware and built/firmware/slot_b" in text
    images = installation.packages / "hil_sim/built/firmware"
    files = [images / slot / f"{image}.elf" for image in IMAGES for slot in ("", "slot_b")]
    installation.run("goldfield", "keys", "make", "firmware.key")
    installation.run("goldfield", "image", "sign", *files, "--key", "firmware.key", "--out", "all.gfi")
    shown = installation.run("goldfield", "image", "show", "all.gfi")[0]
    assert all(shown.count(image) == 2 for image in IMAGES)


def test_nothing_of_the_checkout_is_seen_there(installation):
    program = "import goldfield, goldfield_protocol, hil_sim; "
    program += "print(goldfield.__file__, goldfield_protocol.__file__, hil_sim.__file__, sep='\\n')"
    for file in installation.run("python", "-c", program)[0].split():
        assert Path(file).is_relative_to(installation.packages)


def test_the_version_is_one(installation):
    numbers = [line.split()[2].rstrip("u") for line in VERSION_H.read_text().splitlines() if "#define VERSION_" in line]
    said = installation.run("goldfield", "--version")[0]
    assert said == f"goldfield {'.'.join(numbers)}, protocol {protocol_hash():#010x}\n"


def test_locate_finds_the_pose_with_the_kernel_and_without(installation):
    rows = ["epoch,t_s,beacon,bx_T,by_T,bz_T"]
    for place, field in enumerate(beacon_fields()):
        rows.append(f"0,0.0,b{place + 1}," + ",".join(repr(float(value)) for value in field))
    table = installation.write("fields.csv", "\n".join(rows))
    arguments = ("locate", "--site", installation.write("site.toml", SITE.read_text()), table, "--json")
    fast, complaint = installation.run("goldfield", *arguments)
    assert not complaint
    uses = "from goldfield.locate import kernel; print(kernel._library() is not None)"
    assert installation.run("python", "-c", uses)[0] == "True\n"
    with taken_away(installation.packages / KERNEL):
        assert installation.run("python", "-c", uses)[0] == "False\n"
        slow, complaint = installation.run("goldfield", *arguments)
    assert not complaint
    for output in (fast, slow):
        pose = json.loads(output)
        assert pose["status"] == "ok"
        np.testing.assert_allclose(pose["position_m"], POSITION_M, atol=1e-6)
        assert abs(np.dot(pose["orientation_xyzw"], ATTITUDE.as_quat())) == pytest.approx(1.0, abs=1e-9)


def test_run_replays_a_log(installation):
    log = installation.write("a.log", log_of(range(4, 8), [heartbeat()]))
    site = installation.write("site.toml", SITE.read_text())
    output, _ = installation.run("goldfield", "run", "--site", site, "--log", log, "--json")
    poses = [json.loads(line) for line in output.splitlines()]
    assert [pose["epoch"] for pose in poses] == [4, 5, 6, 7]
    for pose in poses:
        np.testing.assert_allclose(pose["position_m"], POSITION_M, atol=0.02)


@pytest.mark.parametrize(("boards", "seconds"), [("host", 2), ("emulated", 0.5)])
def test_the_simulated_bench_runs(installation, boards, seconds):
    arguments = ("prigge8", "--boards", boards, "--seconds", seconds, "--pace", 0, "--can", "none", "--json")
    first, *truth = map(json.loads, installation.run("goldfield", "hil", *arguments)[0].splitlines())
    assert first["boards"] == boards
    assert first["serial"].startswith("/dev/")
    if boards == "host":
        assert len(truth) >= 5
        assert {"t_s", "position_m"} <= set(truth[0])


def test_without_the_images_it_tells_what_to_do(installation):
    with taken_away(installation.packages / "hil_sim" / "built" / "firmware"):
        complaint = installation.run("goldfield", "hil", "prigge8", "--can", "none", code=2)[1]
    assert complaint.count("\n") == 1
    assert "--boards host" in complaint
    assert "make wheel" in complaint


def test_without_the_packages_of_the_simulator_it_tells_what_to_install(installation):
    with taken_away(installation.packages / "elftools"):
        complaint = installation.run("goldfield", "hil", "prigge8", "--boards", "host", code=3)[1]
    assert complaint.count("\n") == 1
    assert (
        "pip install 'goldfield[dask,docs,feeds,mcap,mf4,parquet,plot,sim,update,view]' brings what it needs"
        in complaint
    )


def test_the_pytest_of_another_project_sees_nothing_of_goldfield(installation):
    test = installation.write(
        "test_other.py",
        "def test_plugins(pytestconfig):\n    import sys\n"
        "    assert not [name for name in sys.modules if name.startswith(('goldfield', 'hil_sim'))]\n",
    )
    installation.run("python", "-m", "pytest", "-q", test)
    words = installation.run("python", "-m", "pytest", "--help", "-p", "no:cacheprovider")[0]
    assert "--rig" not in words
    assert "goldfield" not in words
