"""What holds for every test: the same examples each time, no bound on time, no quiet from before, and the marks.

``--cycles-per-instruction X`` runs whatever a test emulates in its own process with slower instructions.
"""

import dataclasses
import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from goldfield.errors import Loudness, set_loudness
from hil_sim.emulator import Configuration, Emulator

settings.register_profile(
    "goldfield",
    deadline=None,  # a loaded machine is slow
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("goldfield")

# A shell lets what it starts in the background ignore interrupts, and nohup the end of its terminal; a program hands
# that on to the programs that it starts: tests that interrupt one of them need the usual.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

HERE = Path(__file__).parent
LONG = (
    "bench/test_day_run.py",
    "bench/test_integrity_rod.py",
    "bench/test_integrity_trials.py",
    "bench/test_locate_figures.py",
    "bench/test_rate_figures.py",
    "bench/test_readme_figures.py",
    "campaign",
    "docs/test_new_room.py",
    "docs/test_pages.py",
    "firmware/apps",
    "firmware/boards",
    "firmware/core/pose/test_pose_instructions.py",
    "firmware/core/test_instructions.py",
    "firmware/core/test_sanitized.py",
    "firmware/core/timing/test_acquire_instructions.py",
    "firmware/services",
    "fuzz/test_corpora.py",
    "hil",
    "hil_sim/papers/gietler",
    "hil_sim/world/test_reference_circuit.py",
    "hil_sim/world/test_reference_sensor.py",
    "host/access/test_motion_repair.py",
    "host/calibration/test_sensor.py",
    "host/cli/test_hostile_streams.py",
    "host/cli/test_plan.py",
    "host/feeds/test_command.py",
    "host/feeds/test_mqtt.py",
    "host/feeds/test_mqtt_access.py",
    "host/locate/test_locator.py",
    "host/locate/test_own_body.py",
    "host/page/test_browser.py",
    "host/page/test_command.py",
    "host/page/test_guided.py",
    "host/planning",
    "host/recording/test_foxglove_reader.py",
    "host/feeds/test_foxglove_client.py",
    "host/sensor/test_on_sensor.py",
    "host/sensor/test_spread_location.py",
    "host/site/test_dual_axis.py",
    "host/survey/test_metal.py",
    "host/survey/test_survey.py",
    "host/track",
    "image_faults",
    "proofs/test_proofs.py",
)
"""Folders and files that `make check` leaves out: each of them takes many seconds."""

ANY_BENCH = ("hil/test_poses.py",)
"""Files of hil/ that judge whatever bench there is; the others need a simulated one."""


CYCLES_OPTION = "--cycles-per-instruction"


def pytest_addoption(parser):
    """Add the option."""
    parser.addoption(
        CYCLES_OPTION,
        metavar="X",
        help="cycles of an instruction on boards that a test emulates and does not slow down itself: 1 to 100, or m4",
    )


def pytest_configure(config):
    """Slow down every emulated board whose test says nothing of cycles."""
    cycles = config.getoption(CYCLES_OPTION)
    if cycles is None:
        return
    try:
        slow = dataclasses.asdict(Configuration.with_cycles(cycles))
    except ValueError as error:
        raise pytest.UsageError(f"{CYCLES_OPTION} {cycles}: is neither a number nor m4") from error
    costs = {name: slow[name] for name in ("cycles_per_instruction", "cycles_by_class")}
    create = Emulator.__init__

    def create_slow(self, image, configuration=None, **others):
        wanted = configuration or Configuration()
        plain = all(getattr(wanted, name) == getattr(Configuration(), name) for name in costs)
        create(self, image, dataclasses.replace(wanted, **costs) if plain else wanted, **others)

    Emulator.__init__ = create_slow


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark the tests of those places, before pytest selects by marks."""
    long, any_bench = ([HERE / place for place in places] for places in (LONG, ANY_BENCH))
    missing = [str(place) for place in (*long, *any_bench) if not place.exists()]
    if missing:
        raise pytest.UsageError(f"tests/conftest.py names places that are not there: {', '.join(missing)}")
    of_long = {path: not set(long).isdisjoint((path, *path.parents)) for path in {item.path for item in items}}
    for item in items:
        if of_long[item.path]:
            item.add_marker(pytest.mark.long)
        if item.path.is_relative_to(HERE / "hil") and item.path not in any_bench:
            item.add_marker(pytest.mark.simulated_bench)
        if "rig_kind" in item.fixturenames:  # of its own, or through another fixture
            item.add_marker(pytest.mark.both_boards)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup():
    """Let each test begin as loud as usual, whatever a command was asked for in the one before it in this process."""
    set_loudness(Loudness.USUAL)
