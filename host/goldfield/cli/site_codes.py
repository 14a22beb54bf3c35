"""What ``goldfield site codes`` prints of a plan of codes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from goldfield.errors import counted
from goldfield.planning.code_plan import CodePlan
from goldfield.site import Site


def record(plan: CodePlan, site: Site) -> dict[str, Any]:
    """Return the JSON object of a plan."""
    worst = plan.interference
    return {
        "beacons": len(plan.code),
        "codes": len(np.unique(plan.code)),
        "places": plan.places,
        "same_dB": _decibels(worst.same),
        "bound_dB": _decibels(plan.bound),
        "leak_dB": _decibels(worst.leak),
        "worst_dB": _decibels(worst.total),
        "worst_beacon": site.beacons[worst.beacon].id,
        "worst_m": worst.point_m.tolist(),
        "alike": plan.alike,
        "seconds": plan.seconds,
    }


def text(plan: CodePlan, site: Site) -> str:
    """Return what is printed for people."""
    told = record(plan, site)
    lines = [
        f"{counted(told['beacons'], 'beacons')}, {counted(told['codes'], 'codes')}, "
        f"{counted(told['places'], 'places')}, {plan.seconds:.1f} s"
    ]
    if told["same_dB"] is None:
        lines.append("no two beacons share a code")
    else:
        lines.append(
            f"same code: the other beacons' field is {told['same_dB']:.1f} dB of a used one at most; no other choice "
            f"of {counted(told['codes'], 'codes')} has less than {told['bound_dB']:.1f} dB"
        )
        lines.append(
            f"alike: of the beacons around one, {plan.alike} at most have codes that are together elsewhere, too"
        )
    if told["leak_dB"] is not None:
        lines.append(f"other codes: what is not reported leaks {told['leak_dB']:.1f} dB of a used field at most")
    if told["worst_dB"] is not None:
        place = ", ".join(f"{value:.2f}" for value in told["worst_m"])
        lines.append(f"worst of all: {told['worst_dB']:.1f} dB of the field of {told['worst_beacon']}, at ({place}) m")
    return "\n".join(lines)


def _decibels(ratio: float) -> float | None:
    return 20.0 * math.log10(ratio) if ratio > 0.0 else None
