"""Fuzz one of the harnesses of this folder: ``python -m tests.fuzz.host TARGET [libFuzzer's options] CORPUS``."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import atheris

PACKAGES = ["goldfield", "goldfield_protocol", "hil_sim", "can.io", "mcap"]
"""What is instrumented: where the fuzzer sees which way an input has gone."""


def main() -> None:
    """Fuzz until libFuzzer's options end it."""
    there = sorted(path.stem for path in Path(__file__).parent.glob("[a-z]*.py") if path.stem != "judging")
    if len(sys.argv) < 2 or sys.argv[1] not in there:
        sys.exit(f"fuzz: give a target first, one of {', '.join(there)}")
    target = sys.argv.pop(1)
    with atheris.instrument_imports(include=PACKAGES):
        harness = importlib.import_module(f"tests.fuzz.host.{target}")
    atheris.Setup(sys.argv, harness.one_input)
    atheris.Fuzz()


main()
