"""The source archive has all that its make files ask for: a wheel is built from it as from a checkout."""

import subprocess
import sys
import tarfile

from hil_sim.clib import ROOT


def test_make_finds_its_parts_in_the_archive(tmp_path):
    out = tmp_path / "out"
    own_base = ["egg_info", "--egg-base", str(tmp_path)]  # else the list of an earlier archive is added to this one
    command = [sys.executable, "setup.py", "-q", *own_base, "sdist", "--formats=tar", "--dist-dir", str(out)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (archive,) = out.iterdir()
    with tarfile.open(archive) as file:
        file.extractall(out, filter="data")
    done = subprocess.run(
        ["make", "-n", "firmware"], cwd=archive.with_suffix(""), check=False, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "arm-none-eabi-gcc" in done.stdout
