"""``goldfield paper``: the published experiments repeated."""

from __future__ import annotations

from typing import Any

from hil_sim.papers.gietler import command as gietler
from hil_sim.papers.prigge import command as prigge
from hil_sim.papers.zheng import command as zheng


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "paper",
        description="The experiments of the sources, repeated with the host's methods in simulated worlds.",
    )
    papers = parser.add_subparsers(title="papers", metavar="PAPER", required=True)
    for paper in (prigge, zheng, gietler):
        paper.command(papers)
