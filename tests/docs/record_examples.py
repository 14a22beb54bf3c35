"""Record docs/examples anew from a simulated bench: ``python -m tests.docs.record_examples``.

The recording holds heartbeats, which tell the protocol's hash: it is recorded again whenever a message changes.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from tests.docs.test_examples import EXAMPLES, bench

SECONDS = 4
EPOCHS = 10
"""Epochs that the table of fields keeps."""


def main() -> None:
    """Write the recording and the table of fields."""
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        fields, recording = directory / "fields.csv", directory / "recording.log"
        with bench(directory) as port:
            command = ["run", "--port", port, "--site", str(EXAMPLES / "room.toml"), "--seconds", str(SECONDS)]
            command += ["--record", str(recording), "--fields", str(fields)]
            subprocess.run([sys.executable, "-m", "goldfield", *command], check=True)
        (EXAMPLES / "recording.log").write_bytes(recording.read_bytes())
        header, *rows = fields.read_text(encoding="utf-8").splitlines()
        kept = list(dict.fromkeys(row.split(",")[0] for row in rows))[:EPOCHS]
        rows = [row for row in rows if row.split(",")[0] in kept]
        (EXAMPLES / "fields.csv").write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
