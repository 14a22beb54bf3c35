"""The table of a campaign: one line a kind."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from goldfield.errors import counted
from tests.campaign.trial import Outcome

HEAD = (
    f"{'kind':<58}{'trials':>7}{'detected':>9}{'median':>8}{'worst s':>8}  {'by, most often':<16}"
    f"{'wrong':>6}{'lost':>6}{'back':>6}{'worst s':>8}"
)


def shown(outcomes: list[Outcome]) -> str:
    """Return the table; its head tells if not all trials are of the same sources.

    The columns: trials; those in which something was said; how soon, s; what was said first; poses that are said to be
    right (`ok`, `unverified`) and are off by more than their protection level, among all; cycles without a pose; trials
    in which all was plain again; how soon after the fault, s.
    """
    builds = Counter(one.build or "unknown sources" for one in outcomes)
    mixed = ", ".join(f"{counted(count, 'trials')} of {build}" for build, count in builds.most_common())
    lines = ([f"not of one build: {mixed}"] if len(builds) > 1 else []) + [HEAD]
    by_kind: dict[tuple[str, str], list[Outcome]] = {}
    for one in outcomes:
        by_kind.setdefault((one.group, one.name), []).append(one)
    lines += [_line(f"{group}: {name}", found) for (group, name), found in by_kind.items()]
    poses, wrong = sum(one.poses for one in outcomes), sum(one.wrong for one in outcomes)
    lines.append(f"{len(by_kind)} kinds, {len(outcomes)} trials, {poses} poses from the faults on, {wrong} wrong")
    ended = Counter(one.error for one in outcomes if one.error)
    lines += [f"{count} ended: {error}" for error, count in ended.most_common()]
    return "\n".join(lines)


def _line(name: str, found: list[Outcome]) -> str:
    detected = [one.detected_s for one in found if one.detected_s is not None]
    back = [one.recovered_s for one in found if one.recovered_s is not None]
    words = Counter(one.by for one in found if one.by).most_common(1)
    lost = sum(max(0, one.expected - one.poses) for one in found)
    first = words[0][0] if words else ""
    noticed = f"{len(detected):>9}{_seconds(detected, np.median):>8}{_seconds(detected, max):>8}"
    wrong = sum(one.wrong for one in found)
    return (
        f"{name[:57]:<58}{len(found):>7}{noticed}  {first[:15]:<16}{wrong:>6}{lost:>6}"
        f"{len(back):>6}{_seconds(back, max):>8}"
    )


def _seconds(values: list[float], of: Callable[[list[float]], Any]) -> str:
    return f"{of(values):.2f}" if values else "-"
