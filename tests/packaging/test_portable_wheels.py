"""The wheels that ``make wheels`` builds with Zig: what they ask of a system, installed where there is no compiler.

The one for x86_64 runs here, that for aarch64 with Debian's Python for arm64 in QEMU's user mode, which runs every
instruction as an ARM processor would. ``make test-wheels`` builds both and what is needed for this.
"""

import json
import re
import shutil
import subprocess
import sys
import venv
import zipfile

import numpy as np
import pytest

from hil_sim.clib import LIBRARIES, ROOT

pytestmark = pytest.mark.slow

DIST = ROOT / "build/wheels/dist"
TOOLS = ROOT / "build/wheels/tools/bin"
ARM64 = ROOT / "build/arm64"
QEMU = shutil.which("qemu-aarch64-static")
PYTHON = "3.11"
EXAMPLES = ROOT / "docs/examples"
RUN = ("run", "--log", str(EXAMPLES / "recording.log"), "--site", str(EXAMPLES / "room.toml"), "--json")
LOCATE = ("locate", str(EXAMPLES / "fields.csv"), "--site", str(EXAMPLES / "room.toml"), "--json")
TRACKED = (*RUN, "--track")
KERNELS = (
    "from goldfield.locate import kernel; from goldfield.track.blocks.kernel import library; "
    "print(kernel._library() is not None, library.opened() is not None)"
)


def wheel_of(processor):
    found = sorted(DIST.glob(f"goldfield-*-py3-none-manylinux_2_28_{processor}.whl"))
    if not found:
        pytest.skip(f"there is no wheel for {processor}: make wheels builds it")
    return found[-1]


def poses(output):
    return [json.loads(line) for line in output.splitlines()]


class Installation:
    """The wheel and all that pip takes with it, none of it compiled here, and the program that runs it."""

    def __init__(self, python, packages, environment):
        self._python, self._environment = python, {**environment, "PYTHONPATH": str(packages)}

    def python(self, *words):
        done = subprocess.run(
            [*self._python, *words], env=self._environment, cwd="/", capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    def goldfield(self, *words):
        return self.python("-m", "goldfield", *words)


def install(wheel, packages, *platform):
    """Let pip install a wheel and its dependencies from wheels alone."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "-q", "--only-binary=:all:"]
    subprocess.run([*pip, "--target", packages, *platform, f"{wheel}[view]"], check=True, capture_output=True)


def for_platform(processor, python=PYTHON):
    names = [f"manylinux_2_{minor}_{processor}" for minor in range(28, 16, -1)]
    words = [word for name in (*names, f"manylinux2014_{processor}") for word in ("--platform", name)]
    return [*words, "--python-version", python, "--implementation", "cp"]


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """Return an installation for this machine, with nothing on the path but Python."""
    wheel = wheel_of("x86_64")
    directory = tmp_path_factory.mktemp("here")
    venv.create(directory / "environment", with_pip=False)
    install(wheel, directory / "packages")
    programs = directory / "environment/bin"
    return Installation([programs / "python"], directory / "packages", {"PATH": str(programs)})


@pytest.fixture(scope="module")
def pi(tmp_path_factory):
    """Return an installation for aarch64, in QEMU."""
    wheel = wheel_of("aarch64")
    root = ARM64 / "root"
    python = root / "usr/bin" / f"python{PYTHON}"
    if QEMU is None or not python.exists():
        pytest.skip("QEMU's user mode or Debian's Python for arm64 is missing: make test-wheels brings both")
    packages = tmp_path_factory.mktemp("pi")
    install(wheel, packages, *for_platform("aarch64"))
    return Installation([QEMU, "-L", root, python], packages, {"PATH": "/nowhere", "OPENBLAS_NUM_THREADS": "1"})


@pytest.fixture(scope="module")
def blocks(tmp_path_factory):
    """Return the command that tracks a recording with blocks of chips, made by boards that are compiled for here."""
    directory = tmp_path_factory.mktemp("blocks")
    site, log = str(directory / "site.toml"), str(directory / "blocks.log")
    goldfield = [sys.executable, "-m", "goldfield"]
    words = ["hil", "prigge8", "--boards", "host", "--pace", "0", "--can", "none", "--json", "--site", site]
    bench = subprocess.Popen([*goldfield, *words], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        port = json.loads(bench.stdout.readline())["serial"]
        words = ["run", "--port", port, "--site", site, "--rate", "330", "--seconds", "2", "--json", "--record", log]
        subprocess.run([*goldfield, *words], check=True, capture_output=True)
    finally:
        bench.terminate()
        bench.communicate()
    return ("run", "--log", log, "--site", site, "--rate", "330", "--json")


@pytest.mark.parametrize("processor", ["x86_64", "aarch64"])
def test_auditwheel_finds_nothing_newer_than_glibc_2_28_in_it(processor):
    wheel = wheel_of(processor)
    shown = subprocess.run([TOOLS / "auditwheel", "show", wheel], capture_output=True, text=True, check=True)
    versions = re.findall(r"GLIBC_(\d+)\.(\d+)", shown.stdout)
    assert versions
    assert max((int(major), int(minor)) for major, minor in versions) <= (2, 28)
    assert f'"linux_{processor}"' in " ".join(shown.stdout.split())  # for nothing but the library of Unicorn
    assert re.findall(r'"(lib\S+)": null', shown.stdout) in ([], ["libunicorn.so.2"])
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {f"hil_sim/built/{library}" for library in LIBRARIES} <= names
    assert {"goldfield/page/built/index.html", "goldfield/locate/kernel/built/libgf_locate.so"} <= names
    assert any(name.endswith("share/goldfield/goldfield-run.service") for name in names)


@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13"])
def test_pip_finds_a_wheel_of_everything_for_an_aarch64_machine(python):
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--dry-run", "--only-binary=:all:"]
    wheel = wheel_of("aarch64")
    done = subprocess.run(
        [*pip, "--target", "/nowhere", *for_platform("aarch64", python), f"{wheel}[view]"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "unicorn" not in done.stdout  # which only the simulator needs


def test_where_there_is_no_compiler_both_kernels_are_there_and_the_example_gives_its_poses(here):
    assert here.python("-c", KERNELS) == "True True\n"
    assert len(poses(here.goldfield(*RUN))) == len(poses(here.goldfield(*TRACKED))) > 20


def test_aarch64_gives_the_poses_of_x86_64(here, pi, blocks):
    assert pi.python("-c", "import platform; print(platform.machine())") == "aarch64\n"
    assert pi.python("-c", KERNELS) == "True True\n"
    worst_m = worst_rad = count = 0
    for command in (RUN, TRACKED, LOCATE, blocks):
        ours, theirs = poses(here.goldfield(*command)), poses(pi.goldfield(*command))
        assert len(ours) == len(theirs) > 0
        count += len(ours)
        for one, other in zip(ours, theirs, strict=True):
            assert {key: one[key] for key in ("epoch", "status", "used")} == {
                key: other[key] for key in ("epoch", "status", "used")
            }
            worst_m = max(worst_m, float(np.abs(np.subtract(one["position_m"], other["position_m"])).max()))
            turned = 2.0 * np.linalg.norm(np.subtract(one["orientation_xyzw"], other["orientation_xyzw"]))
            worst_rad = max(worst_rad, float(turned))
    print(f"\n{count} poses of aarch64 beside x86_64: {worst_m:.1e} m, {worst_rad:.1e} rad at most")
    assert worst_m < 1e-7
    assert worst_rad < 1e-7


def test_the_simulator_s_libraries_are_those_of_the_processor_and_say_what_they_need(pi):
    program = (
        "from hil_sim.clib import load_built\nfor name in ('libgf_rig.so', 'libgf_hostboard.so'): load_built(name)\n"
    )
    program += "try: load_built('libgf_emulator.so')\nexcept FileNotFoundError as error: print(error)"
    said = pi.python("-c", program)
    assert "libunicorn.so.2" in said
    assert "pip install 'goldfield[sim]'" in said
