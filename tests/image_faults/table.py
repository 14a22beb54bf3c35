"""The table of the outcomes: skips by module, flips by workload; then each trial that went wrong."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable

from tests.image_faults.image import instructions
from tests.image_faults.trial import NOT_STRUCK, Outcome
from tests.image_faults.workload import DANGEROUS, VERDICTS, WRONG, Workload

HEAD = f"{'':<28}{'instructions':>13}{'reached':>9}{'trials':>8}" + "".join(f"{name:>16}" for name in VERDICTS)
KINDS = {"flip": "bits of registers", "ram": "bits of the drive's state"}


def _line(name: str, of: str, reached: str, outcomes: list[Outcome]) -> str:
    counts = Counter(one.verdict for one in outcomes)
    others = sum(counts.values()) - sum(counts[name] for name in (*VERDICTS, NOT_STRUCK))
    words = "".join(f"{counts[verdict]:>16}" for verdict in VERDICTS)
    trials = len(outcomes) - counts[NOT_STRUCK]
    return f"{name:<28}{of:>13}{reached:>9}{trials:>8}{words}" + (f"  {others} came to no end" if others else "")


def shown(outcomes: list[Outcome], workloads: Iterable[Workload]) -> str:
    """Return the table.

    The columns: instructions of the module in the images; how many of them a trial has skipped; trials in which the
    upset struck; what became of them.
    """
    images = {workload.image for workload in workloads}
    sizes = Counter(one.module for image in images for one in instructions(image).values())
    skips: dict[str, list[Outcome]] = defaultdict(list)
    flips: dict[str, list[Outcome]] = defaultdict(list)
    for one in outcomes:
        workload, kind, _ = one.id.split("/", 2)
        if kind == "skip":
            skips[one.module].append(one)
        else:
            flips[f"{KINDS[kind]}, {workload}"].append(one)
    lines = [HEAD]
    for module, found in skips.items():
        places = {(one.image, one.id.split("/")[2]) for one in found if one.verdict != NOT_STRUCK}
        lines.append(_line(f"skips in {module}", str(sizes[module]), str(len(places)), found))
    lines += [_line(name, "", "", found) for name, found in flips.items()]
    lines.append(_line("all", "", "", outcomes))
    lines += [
        f"{one.verdict}: {one.id} {one.function}: {one.why}"
        for one in outcomes
        if one.verdict not in VERDICTS[:2] and one.verdict != NOT_STRUCK
    ]
    return "\n".join(lines)


def wrong(outcomes: Iterable[Outcome]) -> list[Outcome]:
    """Return the outcomes that must not be."""
    return [one for one in outcomes if one.verdict in (WRONG, DANGEROUS)]
