"""Tables of the integrity figures: systematic faults, halls, declared errors, a steel rod, recovery."""

from __future__ import annotations

import numpy as np

from goldfield.site import Site
from tests.bench.integrity_coils import Coils, attitudes, measured
from tests.bench.integrity_faults import Systematic, systematic
from tests.bench.integrity_floor import fewest_missed
from tests.bench.integrity_outcome import Outcome, evaluations, joined, judged, times_s
from tests.bench.integrity_recovery import ERROR_M, SOON, Outage
from tests.bench.integrity_rod import FERRITE, STEEL, Material, Rod
from tests.bench.integrity_run import Run
from tests.bench.integrity_sites import Errors, KeysUnknown, cube, halls, sigma_of, told
from tests.bench.integrity_survey import bound_m, really
from tests.bench.integrity_tables import (
    POSES,
    STATUS_COLUMNS,
    STATUS_NOTE,
    WRONG_COLUMNS,
    Cell,
    Column,
    Table,
    largest,
    median,
    progress,
    root_mean_square,
    status_cells,
    wrong_cells,
)
from tests.bench.locate_trials import Trials, cube_positions

DEGREE = np.pi / 180.0


def _systematic_run(fault: Systematic, site: Site, poses: int, rng: np.random.Generator) -> Trials:
    position = cube_positions(rng, poses)
    coils = Coils.of(site, poses).scaled(fault.currents)
    return measured(coils.field(position), position, sigma_of(site), rng, fault.sensor)


def systematic_faults(run: Run) -> None:
    """Print what becomes of faults of the whole sensor, all currents or the site file, eight beacons."""
    label = Column("Prigge's cube", -20)
    for noise_T in (2e-7, 2e-8):
        title = f"Systematic faults, 8 beacons, {noise_T * 1e7:g} mG a sample"
        note = STATUS_NOTE + ";\nnamed: poses that name it; min: `ok` that the best test of one axis' gain leaves"
        last = Column("named", 5), Column("min", 3)
        table = Table(title, note, (label, Column("poses", 5), *STATUS_COLUMNS, *WRONG_COLUMNS, *last))
        for name, fault in progress(systematic().items(), title):
            site = cube(noise_T)
            trials = _systematic_run(fault, site, run.poses, run.rng("systematic", name, noise_T))
            outcome = judged(run.told(fault.tells(site)), trials)
            named = sum(fault.kind in kinds for kinds in outcome.named)
            least = str(round(fewest_missed(site, trials, fault.sensor))) if fault.kind == "axis_gain" else "-"
            table.row(name, *status_cells(outcome), *wrong_cells(outcome), named, least)


COUNTED = 2000
"""Poses of a row whose evaluations are counted: one by one, which takes several times as long as all at once."""


def halls_of_few(run: Run) -> None:
    """Print what becomes of sound poses in halls of few coils, anywhere and within a radius of a coil."""
    times = tuple(Column(heading, 4, 1) for heading in ("ms", "most"))
    work = Column("evals", 5), Column("most", 5)
    table = Table(
        "Sound poses in halls of 10 x 10 x 3.5 m with random coils, .2 mG a sample",
        STATUS_NOTE + ";\nnear: within a radius of a coil; ms: processor time of 300 poses one by one, median;\nevals: "
        f"evaluations of all coils' field at a place, of {COUNTED} poses, median",
        (Column("beacons", -7), POSES, *STATUS_COLUMNS, *WRONG_COLUMNS, *times, *work),
    )
    rows = [(beacons, near) for near in (False, True) for beacons in (3, 4, 5, 6, 8, 12)]
    for beacons, near in progress(rows, "halls"):
        rng = run.rng("halls", beacons, near)
        parts: list[Outcome] = []
        spent: list[float] = []
        counted: list[int] = []
        for true, position in halls(rng, run.poses, beacons, near):
            site = run.told(true)
            trials = measured(Coils.of(true, len(position)).field(position), position, sigma_of(true), rng)
            parts.append(judged(site, trials))
            if len(spent) < 300:
                spent += times_s(site, trials, 10)
            counted += evaluations(site, trials, COUNTED - len(counted))
        outcome = joined(parts)
        label = f"{beacons}{' near' if near else ''}"
        ms = 1e3 * np.array(spent)
        cells: list[Cell] = [float(np.median(ms)), float(ms.max())]
        cells += [round(float(np.median(counted))), max(counted)]
        table.row(label, *status_cells(outcome), *wrong_cells(outcome), *cells)


CENTIMETRE = Errors(0.01, DEGREE, 0.01)
DEFAULT = Errors(0.003, 0.005, 0.003, gain=0.003, sensor_axis_rad=0.005)
"""What a silent site file is taken for; the truth is drawn with half of it, with it and with twice of it."""


def _survey_rows() -> list[tuple[str, Errors | None, Errors, bool]]:
    """Name, what the file says, what is true, and whether in halls too."""
    sensor = Errors(gain=0.01, sensor_axis_rad=0.01)
    return [
        ("said exact, exact", Errors(), Errors(), True),
        ("1 cm, 1 deg, 1 %", CENTIMETRE, CENTIMETRE, True),
        ("sensor 1 %, .01 rad", sensor, sensor, False),
        ("nothing said, exact", None, Errors(), True),
        ("nothing said, half", None, DEFAULT.times(0.5), True),
        ("nothing said, default", None, DEFAULT, True),
        ("nothing said, twice", None, DEFAULT.times(2.0), True),
    ]


def declared_errors(run: Run) -> None:
    """Print what becomes of sites with errors of survey and sensor, said in the site file or not."""
    table = Table(
        "Errors of survey and sensor: really drawn for each pose anew",
        f"default: {DEFAULT.position_m * 1e3:g} mm, {DEFAULT.axis_rad:g} rad, {DEFAULT.current:.1%}; sensor "
        f"{DEFAULT.gain:.1%}, {DEFAULT.sensor_axis_rad:g} rad; nees: normalised error squared per axis,\n"
        "NEES/3, its mean and median; rms error, and bound (these errors included, by differences of\n"
        "magpylib's fields), mm, and rms of each error over its bound: of `ok` and `unverified` poses",
        (
            Column("said, and true", -21),
            Column("site", -10),
            POSES,
            Column("ok %", 6, 1),
            Column("unver", 5),
            Column("incon", 5),
            Column("nees", 6, 2),
            Column("median", 6, 2),
            Column("rms", 6, 1),
            Column("bound", 6, 1),
            Column("ratio", 6, 3),
            Column(">PL", 4),
        ),
    )
    rows = []
    for name, said, true, in_halls in _survey_rows():
        rows += [(name, said, true, "cube 2 mG"), (name, said, true, "cube .2 mG")]
        rows += [(name, said, true, f"hall of {n}") for n in (8, 5, 4) if in_halls]
    for name, said, true, place in progress(rows, "survey"):
        try:
            outcome, bound = _survey_row(run, name, said, true, place)
        except KeysUnknown:
            table.row(name, place, "  keys not known", *[""] * 9)
            continue
        good = outcome.passed
        error, least = root_mean_square(outcome.error_m[good]), root_mean_square(bound[good])
        nees = outcome.nees[good]
        table.row(
            name,
            place,
            len(outcome),
            100.0 * float(outcome.ok.mean()),
            outcome.counts()["unverified"],
            outcome.counts()["inconsistent"],
            float(nees.mean()) if len(nees) else float("nan"),
            median(nees),
            1e3 * error,
            1e3 * least,
            root_mean_square(outcome.error_m[good] / bound[good]),
            int(outcome.unprotected.sum()),
        )


def _survey_row(run: Run, name: str, said: Errors | None, true: Errors, place: str) -> tuple[Outcome, np.ndarray]:
    rng = run.rng("survey", name, place)
    if place.startswith("cube"):
        site = cube(2e-7 if place == "cube 2 mG" else 2e-8)
        rooms = [(site, cube_positions(rng, run.poses))]
    else:
        rooms = list(halls(rng, run.poses, int(place.rpartition(" ")[2])))
    parts, bounds = [], []
    for site, position in rooms:
        coils, sensor = really(site, len(position), true, rng)
        trials = measured(coils.field(position), position, sigma_of(site), rng, sensor)
        parts.append(judged(told(site, said), trials))
        bounds.append(bound_m(site, position, trials.rotation, sigma_of(site), true))
    return joined(parts), np.concatenate(bounds)


ROD_SEEDS = 20
ROD_DISTANCES_M = (0.02, 0.04, 0.08, 0.16, 0.32)


def steel_rod(run: Run) -> None:
    """Print what becomes of poses with a rod beside the sensor, and of the same without it."""
    table = Table(
        "A rod, 100 mm long, 10 mm thick, goes with the sensor, its surface this far from it; 8 beacons",
        STATUS_NOTE + f";\nrods of {ROD_SEEDS} seeds, see integrity_rod.py; bad: beyond protection_m, or `ok` without "
        "a finite one\nand wrong by either rule",
        (Column("rod", -22), POSES, *STATUS_COLUMNS, *WRONG_COLUMNS, Column("bad", 5)),
    )
    rows: list[tuple[str, Site, Material | None, float]] = []
    for noise_T in (2e-7, 2e-8):
        site, suffix = cube(noise_T), f"{noise_T * 1e7:g} mG"
        rows.append((f"none, {suffix}", site, None, 0.0))
        for name, material in (("steel", STEEL), ("ferrite", FERRITE)):
            for distance in ROD_DISTANCES_M if material is STEEL else ROD_DISTANCES_M[:1]:
                rows.append((f"{name} {1e3 * distance:g} mm, {suffix}", site, material, distance))
    for name, site, material, distance in progress(rows, "rod"):
        parts = []
        for seed in range(ROD_SEEDS):
            rng = run.rng("rod", name, seed)
            count = max(run.poses // ROD_SEEDS, 1)
            position, rotation = cube_positions(rng, count), attitudes(rng, count)
            coils = Coils.of(site, count)
            field = coils.field(position)
            if material is not None:
                field = field + Rod.beside(rng, distance, material).added(coils, position, rotation)
            parts.append(judged(run.told(site), measured(field, position, sigma_of(site), rng, rotation=rotation)))
        outcome = joined(parts)
        unknown = outcome.passed & ~np.isfinite(outcome.protection_m)
        wrong = outcome.wrong_by_covariance | outcome.wrong_by_distance
        bad = int((outcome.unprotected | (unknown & wrong)).sum())
        table.row(name, *status_cells(outcome), *wrong_cells(outcome), bad)


MOTIONS = ((0.5, 0.5), (1.0, 1.0))


def recovery(run: Run) -> None:
    """Print how soon a track is `ok` after all beacons were lost for 1 to 60 s."""
    trials = max(run.poses // 10, 1)
    table = Table(
        "Recovery: on a circle all 8 beacons are lost for 1 to 60 s (logarithmically uniform), then return",
        f"soon: `ok` within {SOON} cycles; wrong: some `ok` pose after it off by more than {100 * ERROR_M:g} cm;"
        "\nin loss: `ok` poses more than a second into the loss; worst error after it, m",
        (
            Column("motion, loss", -39),
            Column("trials", 6),
            Column("soon", 6),
            Column("wrong", 6),
            Column("cycles max", 10),
            Column("in loss", 8),
            Column("max m", 8, 3),
        ),
    )
    rows = [
        (noise_T, silent, speed, rate)
        for noise_T in (2e-7, 2e-8)
        for silent in (True, False)
        for speed, rate in MOTIONS
    ]
    for noise_T, silent, speed, rate in progress(rows, "recovery"):
        rng = run.rng("recovery", noise_T, silent, speed)
        outage = Outage(run.told(cube(noise_T)), noise_T, silent)
        found = [outage.run(60.0 ** rng.uniform(), speed, rate, rng) for _ in range(trials)]
        name = f"{noise_T * 1e7:g} mG, {speed:g} m/s {rate:g} rad/s, {'no epochs' if silent else 'only noise'}"
        soon = [one for one in found if one.cycles <= SOON]
        table.row(
            name,
            trials,
            len(soon),
            sum(one.error_m > ERROR_M for one in found),
            max(one.cycles for one in found),
            sum(one.said_ok for one in found),
            largest(np.array([one.error_m for one in found])),
        )
