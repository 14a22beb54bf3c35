"""What pyproject.toml cannot say: the C parts of the wheel, in folders ``built`` that no one takes for Python modules.

The kernels of ``goldfield.locate`` and of ``goldfield.track.blocks`` are plain shared libraries: they use nothing of
Python's C interface, so that neither Python's headers nor its version matter. The simulator's libraries and images are
made by the Makefile, which alone knows how; here they are collected. A part that cannot be built is left out with a
sentence, and the rest works without it.
"""

from __future__ import annotations

import logging
import os
import shutil
import subprocess
import sys
from pathlib import Path

from setuptools import Command, Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build import build
from setuptools.command.build_ext import build_ext
from setuptools.errors import BaseError, CCompilerError, CompileError, LinkError

ROOT = Path(__file__).resolve().parent
KERNEL = "host/goldfield/locate/kernel"
BANK = "host/goldfield/track/blocks/kernel"
BANK_CORE = (
    *(f"track/block_{part}" for part in ("filter", "kalman", "measure", "mix", "state", "sweep")),
    *("pose/loop_field", "math/quaternion"),
)
"""What the block filter in the host consists of: sources of the firmware."""
OPTIMISED = ["-std=c11", "-O3", "-fno-math-errno", "-fno-trapping-math"]
"""Nothing reads errno or floating-point traps; saying so lets the compiler work on two coils at a time."""
LIBRARIES = ("libgf_rig.so", "libgf_hostboard.so", "libgf_emulator.so")
PAGE = ROOT / "host/goldfield/page/built/index.html"
IMAGES = (
    *(f"firmware/{slot}{role}.elf" for slot in ("", "slot_b/") for role in ("beacon", "sensor", "anchor")),
    "boot/boot.elf",
)
"""The images of both slots, so that an update file can be made of them, and the boot loader."""
HEADLESS = "host/packaging/headless"
"""Files for a machine without a screen, which are copied from ``share/goldfield`` of an installation to ``/etc``."""
PARTS = os.environ.get("GOLDFIELD_PARTS")
"""The directory where ``make wheel`` has built the simulator's parts; without it they are built here."""
SCRATCH = Path("build/wheel")
"""What setuptools leaves lying, metadata too: in the checkout itself Python would take it for an installed package."""
STAMPS = ("venv", "host-tools", "arm-tools")
"""The Makefile's set-up of a checkout, which is not wanted while pip builds."""


def build_page() -> None:
    """Build the live page beside its sources, from where it is packed; without npm, say that it is left out."""
    if shutil.which("make") and shutil.which("npm"):
        subprocess.run(["make", "--no-print-directory", f"BUILD={SCRATCH}", "page"], cwd=ROOT, check=False)
    if not PAGE.exists():
        logging.warning(
            "goldfield: the live page is left out, because it did not build here: it needs make and npm with Node.js "
            "20.19 or newer. 'goldfield view' says so when it is called."
        )


class Build(build):
    """The usual build, but nothing that an earlier one left gets into the wheel."""

    def run(self) -> None:
        """Build everything."""
        shutil.rmtree(self.build_lib, ignore_errors=True)
        if not PARTS:
            build_page()
        super().run()


class BuildKernel(build_ext):
    """A plain shared library instead of a Python module, by the same command whatever Python was built with."""

    def build_extensions(self) -> None:
        """Compile, on Linux without the flags that Python itself was built with."""
        if sys.platform == "linux":
            compiler = os.environ.get("CC", "gcc")
            flags = os.environ.get("CFLAGS", "")
            self.compiler.set_executables(
                compiler_so=f"{compiler} -fPIC {flags}", linker_so=f"{compiler} -shared -Wl,--strip-debug"
            )
        super().build_extensions()

    def build_extension(self, ext: Extension) -> None:
        """Compile, or say what is missing."""
        try:
            super().build_extension(ext)
        except (BaseError, CCompilerError, CompileError, LinkError) as error:
            logging.warning(
                "goldfield: a C kernel is left out, because it does not compile here (%s). "
                "Poses are the same without it but slower; with gcc installed, install goldfield again.",
                error,
            )

    def copy_extensions_to_source(self) -> None:
        """Put the library beside its sources, for an editable installation."""
        for kernel in (KERNEL, BANK):
            (ROOT / kernel / "built").mkdir(exist_ok=True)
        super().copy_extensions_to_source()

    def get_ext_filename(self, fullname: str) -> str:
        """Return the path of the library, whose name tells no version of Python."""
        return str(Path(*fullname.split("."))) + ".so"

    def get_export_symbols(self, ext: Extension) -> list[str]:
        """Return what must be exported: nothing that Python calls."""
        return list(ext.export_symbols)


class BuildSimulator(Command):
    """Put the simulator's libraries, their declarations and the boards' images into ``hil_sim/built`` of the wheel.

    An editable installation uses those of the checkout instead.
    """

    user_options: list[tuple[str, str, str]] = []  # noqa: RUF012 - the attribute's name and type are setuptools' own
    editable_mode = False

    def initialize_options(self) -> None:
        """See `setuptools.Command`."""
        self.build_lib: str | None = None

    def finalize_options(self) -> None:
        """See `setuptools.Command`."""
        self.set_undefined_options("build", ("build_lib", "build_lib"))
        self.target = Path(str(self.build_lib)) / "hil_sim" / "built"

    def run(self) -> None:
        """Build and copy; without a compiler, say what is left out."""
        if self.editable_mode:
            return
        parts = Path(PARTS) if PARTS else self._make()
        ready = [name for name in (*LIBRARIES, *IMAGES) if (parts / name).exists()]
        missing = [name for name in (*LIBRARIES, *IMAGES) if name not in ready]
        if missing:
            logging.warning(
                "goldfield: the simulator is left without %s, because they did not build here: libraries need gcc and "
                "make, images arm-none-eabi-gcc. 'goldfield hil' says so when it needs them.",
                ", ".join(missing),
            )
        if not ready:
            return
        for name in ready:
            (self.target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(parts / name, self.target / name)
        subprocess.run([sys.executable, "-m", "hil_sim.clib", str(self.target)], cwd=ROOT, check=True)

    def _make(self) -> Path:
        """Let the Makefile build what the compilers at hand can build, in a directory of its own."""
        parts = SCRATCH / "parts"
        wanted = [str(parts / name) for name in LIBRARIES]
        if shutil.which("arm-none-eabi-gcc"):
            wanted += [str(parts / name) for name in IMAGES]
        if shutil.which("make"):
            old = [option for stamp in STAMPS for option in ("-o", str(parts / f"{stamp}.stamp"))]
            inherited = [os.environ["PYTHONPATH"]] if "PYTHONPATH" in os.environ else []  # of pip's build environment
            path = os.pathsep.join([str(ROOT / "host"), str(ROOT / "protocol"), *inherited])
            command = ["make", "--no-print-directory", "-k", "-j2", *old, f"BUILD={parts}", f"PYTHON={sys.executable}"]
            subprocess.run([*command, *wanted], cwd=ROOT, check=False, env={**os.environ, "PYTHONPATH": path})
        return ROOT / parts

    def get_source_files(self) -> list[str]:
        """Return nothing: MANIFEST.in lists the sources."""
        return []

    def get_outputs(self) -> list[str]:
        """Return the files that were copied."""
        return [str(path) for path in self.target.rglob("*") if path.is_file()]

    def get_output_mapping(self) -> dict[str, str]:
        """Return nothing: an editable installation has no copies."""
        return {}


class Wheel(bdist_wheel):
    """A wheel for any Python 3 of one platform, because its libraries know nothing of Python."""

    def get_tag(self) -> tuple[str, str, str]:
        """Return the tags of Python, binary interface and platform."""
        return "py3", "none", super().get_tag()[2]


build.sub_commands.append(("build_simulator", None))
(ROOT / SCRATCH).mkdir(parents=True, exist_ok=True)
setup(
    cmdclass={"build": Build, "build_ext": BuildKernel, "build_simulator": BuildSimulator, "bdist_wheel": Wheel},
    options={"build": {"build_base": str(SCRATCH)}, "egg_info": {"egg_base": str(SCRATCH)}},
    data_files=[("share/goldfield", sorted(str(path.relative_to(ROOT)) for path in (ROOT / HEADLESS).iterdir()))],
    ext_modules=[
        Extension(
            "goldfield.locate.kernel.built.libgf_locate",
            sources=sorted(str(path.relative_to(ROOT)) for path in (ROOT / KERNEL).glob("*.c")),
            depends=sorted(str(path.relative_to(ROOT)) for path in (ROOT / KERNEL).glob("*.h")),
            extra_compile_args=OPTIMISED,
            libraries=["m"],
            optional=True,
        ),
        Extension(
            "goldfield.track.blocks.kernel.built.libgf_bank",
            sources=[
                *sorted(str(path.relative_to(ROOT)) for path in (ROOT / BANK).glob("*.c")),
                f"{KERNEL}/linear.c",
                *(f"firmware/core/{part}.c" for part in BANK_CORE),
            ],
            depends=[
                *sorted(str(path.relative_to(ROOT)) for path in (ROOT / BANK).glob("*.h")),
                f"{KERNEL}/linear.h",
                *sorted(str(path.relative_to(ROOT)) for path in ROOT.glob("firmware/core/*/*.h")),
            ],
            include_dirs=["firmware", KERNEL],
            extra_compile_args=OPTIMISED,
            libraries=["m"],
            optional=True,
        ),
    ],
)
