"""Measure what poses from blocks of 31 chips reach, beside what whole cycles give: docs/motion.md.

``accuracy`` compares on five motions: the block filter at the end of each block, and 50 ms later at the middles of the
cycles; one fix a cycle, held until the next; and the track of whole cycles, at their middles and foretold to the ends
of the blocks. Its samples are streamed by emulated boards, by ``--boards host``, or are ``--simulated``, which costs
least. ``bound`` holds the filter against the least possible error, ``starts`` counts the starts from one block that
fail, ``faults`` counts wrong poses that are told to be right, ``iron`` those while metal of many kinds passes,
``latency`` tells how old a pose is in the rig's time, ``host`` how late a line is on this machine, ``work`` what the
filter takes of the processor for each block, and ``shared`` what comes of several sensors that send blocks on one CAN.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np

from goldfield.site import load
from goldfield.track.blocks import BlockFilter
from goldfield.types import Status
from tests.bench import rate_trials
from tests.bench.locate_trials import prigge_cube
from tests.bench.rate_boards import open_bench, scenario_file, streamed
from tests.bench.rate_bound import LeastError
from tests.bench.rate_host import SPARE_S, blocks_of, played, recorded, work_of_blocks
from tests.bench.rate_iron import ball, copper, passing, sheet
from tests.bench.rate_latency import latency
from tests.bench.rate_shared import shared, shared_scenario
from tests.bench.rate_ways import Errors, cycles, follow, held_fixes, lagged
from tests.bench.rate_world import BLOCK_CHIPS, MOTIONS, World, matched_walks, motion_of
from tests.command import one_of, real_number, whole_number

NOISES_T = (2e-7, 2e-8)
SETTLED_S = 0.5
"""Poses of this first time are left out: the filter has found the motion by then."""
AGILITIES = ((0.05, 0.1), (0.5, 1.0), (2.0, 4.0), (8.0, 15.0))
WALKED_CHIPS = {(0.05, 0.1): 10230, (0.5, 1.0): 7161, (2.0, 4.0): 5115, (8.0, 15.0): 3069}
"""How long random walks of an agility are, in chips: longer ones leave the room."""
FAR_M = 0.1
"""A start that is further off after 33 blocks is lost at 2 mG, and at a fifth of that at 0.2 mG."""


def track_of(options, name, noise_T, seed):
    """Return the samples of a motion from the source that was asked for."""
    if options.simulated:
        world, rng = World(prigge_cube(noise_T)), np.random.default_rng([seed, 10])
        return world.motion_track(motion_of(name, seed), options.seconds, rng, noise_T)
    bench = open_bench(scenario_file(name, seed, noise_T, "stream = 1\n"), options.boards)
    track = streamed(bench, options.seconds)
    bench.close()
    return track


def settled(errors, track):
    """Leave out what belongs to the first time of a track."""
    return errors.after(float(track.times_s[0]) + SETTLED_S)


def accuracy(options):
    """Print the table of motions."""
    source = "simulated samples" if options.simulated else f"chips streamed by {options.boards} boards"
    print(f"Cube of 2.13 m, 8 beacons, {source}; {options.seeds} runs of {options.seconds:g} s of each motion.")
    print("rms position / attitude at the pose's own time, mm / deg; nees: mean normalised square of the six numbers;")
    print("ok: share; wrong: poses that are ok and off by 5 sigma + by more than their protection level; all: poses")
    print(f"{'motion':20s} {'mG':>4} {'block filter':>14} {'nees':>5} {'ok':>5} {'wrong':>7} {'all':>6}", end="")
    print(f" {'50 ms later':>14} {'fix, held':>14} {'cycles, middle':>14} {'ok':>5} {'foretold':>14} {'wrong':>7}")
    for name in MOTIONS:
        for noise_T in NOISES_T:
            ways = [[], [], [], [], []]
            for seed in range(options.first, options.first + options.seeds):
                track = track_of(options, name, noise_T, seed)
                found = [follow(track, BlockFilter(track.site))]
                if not options.alone:
                    found += [lagged(track), held_fixes(track), *cycles(track)]
                for way, errors in zip(ways, found, strict=False):
                    way.append(settled(errors, track))
            blocks, later, held, middle, ahead = (Errors.joined(way) if way else None for way in ways)
            print(
                f"{name:20s} {noise_T * 1e7:4g} {both(blocks)} {blocks.nees:5.2f} {blocks.share_ok:5.3f}"
                f" {blocks.wrong:>7} {len(blocks.status):6d}",
                end="",
            )
            if not options.alone:
                print(f" {both(later)} {both(held)} {both(middle)} {middle.share_ok:5.3f}", end="")
                print(f" {both(ahead)} {ahead.wrong:>7}", end="")
            print(flush=True)


def both(errors):
    """Return rms of position and attitude as a text."""
    if not np.isfinite(errors.distance_m).any():
        return f"{'lost':>14}"
    return f"{f'{errors.rms_mm:.2f} / {errors.rms_deg:.3f}':>14}"


def bound(options):
    """Print the filter's error over the least possible one, on random walks of each agility."""
    print(
        f"{options.seeds} random walks of each agility (m/s^2 and rad/s^2 per root hertz), second halves: rms over the"
    )
    print("least possible error of a filter that has the sums of blocks (and, in brackets, all samples)")
    for agility in AGILITIES:
        count = WALKED_CHIPS[agility] // BLOCK_CHIPS * BLOCK_CHIPS
        for noise_T in NOISES_T:
            site = prigge_cube(noise_T)
            world, rng = World(site), np.random.default_rng([18, options.first])
            walks = matched_walks(rng, options.seeds, count, site.chip_period_s, agility)
            least = LeastError(world, walks, noise_T, agility)
            runs = rate_trials.random_walks(partial(BlockFilter, even_T=np.inf), world, walks, noise_T, options.first)
            half = count // BLOCK_CHIPS // 2
            errors = Errors.joined([run.where(slice(half, None)) for run in runs])
            reached = np.array([errors.rms_mm * 1e-3, np.radians(errors.rms_deg)])
            sums, samples = (rms_of(covariances[:, half:]) for covariances in (least.of_sums(), least.of_samples()))
            over, over_all = reached / sums, reached / samples
            print(
                f"  {agility!s:12s} {noise_T * 1e7:4g} mG  least {1e3 * sums[0]:5.2f} mm {np.degrees(sums[1]):.3f} deg;"
                f" position {over[0]:.3f} ({over_all[0]:.3f}) attitude {over[1]:.3f} ({over_all[1]:.3f})"
                f"  nees {errors.nees:.2f}  wrong {errors.wrong} of {len(errors.status)}",
                flush=True,
            )


def rms_of(covariances):
    """Return the root mean square of position (m) and attitude (rad) that covariances, shape (..., 6, 6), stand for."""
    variances = np.diagonal(covariances, axis1=-2, axis2=-1).reshape(-1, 6).mean(axis=0)
    return np.sqrt(variances.reshape(2, 3).sum(axis=1))


def starts(options):
    """Print how starts from one block go."""
    for noise_T in NOISES_T:
        runs = rate_trials.starts(BlockFilter, noise_T, options.count, options.first)
        far_m = FAR_M * noise_T / 2e-7 if noise_T < 1e-7 else FAR_M
        failed = [number for number, run in enumerate(runs) if rate_trials.lost(run, 2.0 * far_m)]
        where = ", ".join(f"{number}: {1e3 * runs[number].distance_m[-1]:.1f} mm" for number in failed[:9])
        rows = [[run.distance_m[block] for run in runs] for block in (0, 9, 32)]
        rms = " ".join(f"{1e3 * np.sqrt(np.nanmean(np.square(row))):.1f}" for row in rows)
        everything = Errors.joined(runs)
        first = [str(run.status[0]) for run in runs]
        print(
            f"{len(runs)} starts in motion, {noise_T * 1e7:g} mG: {len(failed)} lost ({where}); rms after 1, 10, 33"
            f" blocks {rms} mm; wrong {everything.wrong} of {len(everything.status)} poses;"
            f" first poses {', '.join(f'{first.count(name)} {name}' for name in sorted(set(first)))}",
            flush=True,
        )


FAULTS = {
    "nothing": partial(rate_trials.blocks_lost, lambda number: False),
    "every tenth block lost": partial(rate_trials.blocks_lost, lambda number: number % 10 == 9),
    "each fifth cycle lost": partial(rate_trials.blocks_lost, lambda number: number // 33 % 5 == 4),
    "118 blocks a second": partial(
        rate_trials.blocks_lost, lambda number: (number + 1) * 36 // 100 == number * 36 // 100
    ),
    "33 blocks a second": partial(rate_trials.blocks_lost, lambda number: number % 10 > 0),
    "impulses of 20 uT": rate_trials.impulses,
    "a beacon dies and returns": rate_trials.dead_beacon,
    "1 kg of iron passes": partial(passing, (ball(1.0),)),
    "30 kg of iron pass": partial(passing, (ball(30.0),)),
    "survey off by 3 mm": partial(rate_trials.survey, 0.003),
    "survey off by 10 mm": partial(rate_trials.survey, 0.01),
}
IRON = {
    "5 kg at 0.15 m": (ball(5.0, distance_m=0.15),),
    "100 kg at 1 m": (ball(100.0, distance_m=1.0),),
    "30 kg, no magnet": (ball(30.0, magnetisation_A_m2_kg=0.0),),
    "30 kg at 3 m/s": (ball(30.0, speed_m_s=3.0),),
    "30 kg at 0.2 m/s": (ball(30.0, speed_m_s=0.2),),
    "30 kg carried along": (ball(30.0, speed_m_s=0.0),),
    "two of 15 kg": (ball(15.0), ball(15.0)),
    "sheet, 0.6 m": (sheet(0.3),),
    "copper, 0.2 m": (copper(0.1),),
}
"""Things that pass the sensor, of which the table of `iron` tells."""


def faults(options):
    """Print what mishaps do."""
    print_trials(options, FAULTS)


def iron(options):
    """Print what iron and other metal of many kinds does."""
    print_trials(options, {name: partial(passing, things) for name, things in IRON.items()})


def print_trials(options, trials):
    """Print a table of trials, each on all motions."""
    print(
        f"{options.seeds} runs of {options.seconds:g} s a motion. rms and most, mm; nees; share of each status; wrong:"
    )
    print("ok and off by 5 sigma + ok and off by more than the protection level; last: rms of the last half second, mm")
    for name, trial in trials.items():
        if options.fault is None or options.fault in name:
            for noise_T in NOISES_T:
                runs = [
                    (motion, seed, trial(BlockFilter, noise_T, motion, seed, options.seconds))
                    for motion in MOTIONS
                    for seed in range(options.first, options.first + options.seeds)
                ]
                report(name, noise_T, runs)


def report(name, noise_T, runs):
    """Print one line of `faults`, and in which runs poses are wrong and said to be right."""
    errors = Errors.joined([run.after(SETTLED_S) for _, _, run in runs])
    end = Errors.joined([run.after(run.time_s[-1] - SETTLED_S) for _, _, run in runs])
    counts = {status.value: int(np.sum(errors.status == status)) for status in Status}
    shares = " ".join(f"{status} {number / len(errors.status):.3f}" for status, number in counts.items() if number)
    print(
        f"{name:24s} {noise_T * 1e7:4g} mG {errors.rms_mm:7.2f} {1e3 * np.nanmax(errors.distance_m):8.1f}"
        f" nees {errors.nees:6.2f}  {shares}  wrong {errors.wrong} of {len(errors.status)}  last {end.rms_mm:.2f}",
        flush=True,
    )
    for motion, seed, run in runs:
        if run.unsaid.any():
            first = run.time_s[np.flatnonzero(run.unsaid)[0]]
            print(f"    wrong: {motion}, seed {seed}: {run.wrong} poses, the first at {first:.3f} s", flush=True)


def latencies(options):
    """Print how old poses are: median, 95 %, 99 % and the oldest."""
    for link in ("serial", "can"):
        bench = open_bench(scenario_file("1 m/s, 1 rad/s", options.first, 2e-7), options.boards, link)
        found = latency(bench, BlockFilter(bench.site), options.seconds)
        bench.close()
        late, spent = (quantiles_ms(values) for values in (found.arrival_s, found.update_s))
        rate = 1.0 / (BLOCK_CHIPS * bench.site.chip_period_s)
        print(
            f"{options.boards} boards, {link}, {len(found.arrival_s)} blocks; last chip to last message {late} ms;"
            f" filter's processor time {spent} ms, {100 * rate * found.update_s.mean():.1f} % of a core;"
            f" rms {both(found.errors.where(slice(100, None))).strip()}",
            flush=True,
        )


def quantiles_ms(values_s):
    """Return median, 95 %, 99 % and largest as a text, ms."""
    return " ".join(f"{1e3 * value:.3f}" for value in np.quantile(values_s, (0.5, 0.95, 0.99, 1.0)))


def host(options):
    """Print how late lines of a run at the blocks' rate are on this machine, and what the run takes of it."""
    scenario = scenario_file("1 m/s, 1 rad/s", options.first, 2e-7)
    parts, site = recorded(scenario, options.boards, options.seconds + SPARE_S)
    print("last message read to line written, and processor time meanwhile, all threads: median, 95 %, 99 %, most, ms")
    for _ in range(options.runs):
        summary = played(parts, site, 330.0)
        late = summary["latency"]
        times_ms, work_ms = (
            " ".join(f"{1e3 * spread[name]:.2f}" for name in ("median_s", "p95_s", "p99_s", "most_s"))
            for spread in (late, late["work"])
        )
        print(
            f"8 beacons, serial, {summary['epochs']} lines of JSON: {times_ms}; {work_ms};"
            f" {100 * late['processor_share']:.0f} % of a processor; left out:"
            f" {summary['link'].get('messages left out, because this machine fell behind', 0)} messages; load of the"
            f" machine {os.getloadavg()[0]:.1f} of {os.cpu_count()}",
            flush=True,
        )


def work(options):
    """Print what the filter takes of the processor for each block of a moving sensor."""
    scenario = scenario_file("1 m/s, 1 rad/s", options.first, 2e-7)
    parts, path = recorded(scenario, options.boards, options.seconds)
    site = load(path)
    blocks = blocks_of(parts, site)
    each_s, cycles_s = work_of_blocks(site, blocks, options.replays)
    print(
        f"8 beacons, {len(blocks)} blocks; processor time of the filter, least of {options.replays} replays: median,"
        f" 95 %, 99 %, most: {quantiles_ms(each_s)} ms, mean {1e3 * each_s.mean():.3f}; the first block"
        f" {1e3 * each_s[0]:.2f}; beside it, each of {len(cycles_s)} cycles {quantiles_ms(cycles_s)} ms",
        flush=True,
    )


def several(options):
    """Print what comes of several sensors that send blocks on one CAN."""
    print(
        "| sensors | codes | bus busy | blocks a second | age, ms: median, most | cycles lost | age, ms: median, most |"
    )
    print(f"| --- | --- | --- |{' --- |' * 4}")
    for sensors in (1, 2, 3, 4):
        for codes in options.codes:
            path = Path(tempfile.mkdtemp(prefix="goldfield-figures-")) / "shared.toml"
            bench = open_bench(shared_scenario(sensors, path), options.boards, "can")
            seen, busy = shared(bench, sensors, codes, options.seconds)
            rates = [len(found.blocks) / options.seconds for found in seen.values()]
            due = round(options.seconds / bench.site.cycle_s)
            missed = sum(max(0, due - 1 - len(found.cycles)) for found in seen.values())
            ages = [
                np.array([found.late_ms(bench, what) for found in seen.values()]).max(axis=0)
                for what in ("blocks", "cycles")
            ]
            (block_ms, most_block_ms), (cycle_ms, most_cycle_ms) = ages
            print(
                f"| {sensors} | {codes} | {100 * busy:.0f} % | {min(rates):.0f} to {max(rates):.0f} |"
                f" {block_ms:.1f}, {most_block_ms:.1f} | {missed} of {sensors * due} |"
                f" {cycle_ms:.1f}, {most_cycle_ms:.1f} |",
                flush=True,
            )
            told = {node: found.counters for node, found in seen.items() if found.counters}
            if told:
                print(f"    counters of errors: {told}", flush=True)
            bench.close()


WHAT = {
    "accuracy": accuracy,
    "bound": bound,
    "starts": starts,
    "faults": faults,
    "iron": iron,
    "latency": latencies,
    "host": host,
    "work": work,
    "shared": several,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "what", nargs="*", metavar="NAME", type=one_of(WHAT), help=f"of {', '.join(WHAT)}; default: all"
    )
    parser.add_argument("--boards", choices=("emulated", "host"), default="emulated")
    parser.add_argument("--simulated", action="store_true", help="accuracy: samples without boards")
    parser.add_argument("--alone", action="store_true", help="accuracy: the block filter only")
    parser.add_argument("--seeds", type=whole_number(1), default=3, help="runs of each motion")
    parser.add_argument("--first", type=whole_number(), default=0, metavar="SEED", help="the first of the seeds")
    parser.add_argument(
        "--seconds", type=real_number(1.0), default=3.0, help="length of a run of accuracy, faults, latency, host"
    )
    parser.add_argument("--fault", metavar="NAME", help="faults, iron: those with this in their name only")
    parser.add_argument(
        "--codes", type=whole_number(1), nargs="+", default=[8, 16], help="shared: codes of each sensor"
    )
    parser.add_argument("--count", type=whole_number(1), default=1000, help="starts at each noise")
    parser.add_argument("--runs", type=whole_number(1), default=1, help="host: runs of the command")
    parser.add_argument(
        "--replays", type=whole_number(1), default=7, help="work: replays, of which the least time counts"
    )
    options = parser.parse_args()
    for what in options.what or WHAT:
        begin = time.process_time()
        WHAT[what](options)
        print(f"({what}: {time.process_time() - begin:.0f} s of a processor)\n", flush=True)


if __name__ == "__main__":
    main()
