"""Generate what the firmware takes from ``goldfield.dbc``, ``parameters.toml`` and ``rates.py``.

``python -m goldfield_protocol.codegen DIRECTORY`` writes the packers ``goldfield.c`` and ``goldfield.h`` (cantools),
``protocol_hash.h``, and the tables ``parameter_ids.h``, ``parameter_table.h``, ``counter_ids.h``,
``message_table.h`` and ``link_rates.h``.
"""

from __future__ import annotations

import subprocess
import sys
from importlib import resources
from pathlib import Path

from goldfield_protocol import c_tables
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
    (directory / "parameter_ids.h").write_text(c_tables.ids_header())
    (directory / "parameter_table.h").write_text(c_tables.table_header())
    (directory / "counter_ids.h").write_text(c_tables.counters_header())
    (directory / "message_table.h").write_text(c_tables.messages_header())
    (directory / "link_rates.h").write_text(c_tables.rates_header())


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m goldfield_protocol.codegen DIRECTORY")
    generate(Path(sys.argv[1]))
