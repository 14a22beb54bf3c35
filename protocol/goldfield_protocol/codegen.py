"""Generate the C packers and the protocol hash from ``goldfield.dbc``.

``python -m goldfield_protocol.codegen DIRECTORY`` writes ``goldfield.c``, ``goldfield.h`` (cantools) and
``protocol_hash.h``.
"""

from __future__ import annotations

import subprocess
import sys
from importlib import resources
from pathlib import Path

from goldfield_protocol.messages import DBC, INDEX_SHIFT, NODE_MASK, TYPE_SHIFT, protocol_hash


def generate(directory: Path) -> None:
    """Write the generated sources into the directory, which is created."""
    directory.mkdir(parents=True, exist_ok=True)
    with resources.as_file(DBC) as dbc:
        subprocess.run(
            [
                *(sys.executable, "-m", "cantools", "generate_c_source", "--use-float"),
                *("--database-name", "goldfield", "--output-directory", str(directory), str(dbc)),
            ],
            check=True,
            stdout=subprocess.DEVNULL,
        )
    (directory / "protocol_hash.h").write_text(
        "/* Generated from goldfield.dbc. */\n"
        "#ifndef PROTOCOL_HASH_H\n#define PROTOCOL_HASH_H\n"
        f"#define PROTOCOL_HASH {protocol_hash():#010x}u\n"
        f"#define PROTOCOL_TYPE_SHIFT {TYPE_SHIFT}u\n"
        f"#define PROTOCOL_INDEX_SHIFT {INDEX_SHIFT}u\n"
        f"#define PROTOCOL_NODE_MASK {NODE_MASK:#x}u\n"
        "#endif\n"
    )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m goldfield_protocol.codegen DIRECTORY")
    generate(Path(sys.argv[1]))
