"""Makes a directory with Debian's Python for arm64, to be run by QEMU's user mode: ``python arm64_root.py DIRECTORY``.

Nothing of it is installed: packages are fetched by an apt of their own configuration and unpacked.
"""

import os
import subprocess
import sys
from pathlib import Path

PYTHON = "python3.11"
PACKAGES = (
    *("libc6", "libgcc-s1", "libstdc++6", "libgomp1", "zlib1g", "libbz2-1.0", "liblzma5", "libssl3", "libexpat1"),
    *("libcrypt1", "libffi8", "libsqlite3-0", "libuuid1", "libtinfo6", "libncursesw6", "libreadline8"),
    *(f"lib{PYTHON}-minimal", f"{PYTHON}-minimal", f"lib{PYTHON}-stdlib", PYTHON),
)


def make(root: Path) -> None:
    """Fetch and unpack the packages."""
    apt = root / "apt"
    for part in ("lists/partial", "cache/archives/partial"):
        (apt / part).mkdir(parents=True, exist_ok=True)
    (apt / "status").touch()
    (apt / "apt.conf").write_text(
        'APT::Architecture "arm64";\nAPT::Architectures {"arm64";};\n'
        f'Dir::State::Lists "{apt}/lists";\nDir::State::status "{apt}/status";\nDir::Cache "{apt}/cache";\n'
    )
    environment = {**os.environ, "APT_CONFIG": str(apt / "apt.conf")}
    subprocess.run(["apt-get", "update", "-qq"], env=environment, check=True)
    subprocess.run(["apt-get", "download", "-qq", *PACKAGES], env=environment, cwd=apt / "cache", check=True)
    for package in (apt / "cache").glob("*.deb"):
        subprocess.run(["dpkg-deb", "-x", package, root], check=True)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python arm64_root.py DIRECTORY")
    make(Path(sys.argv[1]).resolve())
