"""Instructions of a Cortex-M4 for one cycle with 1,023 codes: the core's transform beside plain correlation and CMSIS.

CMSIS-DSP is compiled from the sources that `requirements.txt` pins, with its loops unrolled and the instructions for
signal processing; where they are not there (`make bench` fetches them), its rows are left out.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from goldfield.access.gold import code_matrix
from hil_sim.clib import ROOT
from tests.bench.peers.bench import Bench
from tests.bench.peers.row import Goal, Row
from tests.bench.peers.separation import CHIPS, DEGREE, samples
from tests.firmware.cortex_m4 import Machine, link

SUBJECT = "despread"
HERE = Path(__file__).parent
CMSIS = ROOT / "build/bench/cmsis"
"""CMSIS-DSP's sources, a folder with its version in it."""
OF_CMSIS = (
    "BasicMathFunctions/arm_dot_prod_q15",
    "ComplexMathFunctions/arm_cmplx_conj_f32",
    "ComplexMathFunctions/arm_cmplx_mult_cmplx_f32",
    "TransformFunctions/arm_rfft_fast_f32",
    "TransformFunctions/arm_rfft_fast_init_f32",
    "TransformFunctions/arm_cfft_f32",
    "TransformFunctions/arm_cfft_init_f32",
    "TransformFunctions/arm_cfft_radix8_f32",
    "TransformFunctions/arm_bitreversal2",
    "CommonTables/arm_common_tables",
    "CommonTables/arm_const_structs",
)
AXES = 3
LEAST = 100.0
"""How many times fewer instructions than plain correlation the issue asks for."""


def cmsis() -> Path | None:
    """Return the folder of CMSIS-DSP's sources, if they are there."""
    found = sorted(CMSIS.glob("cmsisdsp-*/Source"))
    return found[-1].parent if found else None


def machine(folder: Path, sources: Path) -> Machine:
    """Return a machine with the programs of `despread.c` and the samples of a cycle."""
    flags = ["-O2", "-DARM_MATH_LOOPUNROLL", "-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections"]
    names = ("transform", "read_out", "turn", "plain", "dot_products", "fourier_init", "by_fourier")
    flags += [f"-Wl,--undefined={name}" for name in names]
    includes = (ROOT / "firmware", ROOT / "build/protocol", HERE / "cmsis", sources / "Include")
    flags += [f"-I{path}" for path in (*includes, sources / "PrivateInclude")]
    core = [ROOT / "firmware/core/codes" / name for name in ("despread.c", "gold.c")]
    elf = folder / "despread.elf"
    link(elf, [HERE / "despread.c", *core, *(sources / f"Source/{name}.c" for name in OF_CMSIS)], flags)
    ready = Machine(elf)
    u, v = code_matrix(DEGREE, [CHIPS, CHIPS + 1]).astype(np.int16).T
    ready.write("samples", samples().tobytes())
    ready.write("u_chips", u.tobytes())
    ready.write("v_chips", np.concatenate([v, v]).tobytes())
    return ready


def of_all(cpu: Machine, name: str) -> int:
    """Return the instructions of a peer for all codes, from what each of the first ones adds."""
    counts = []
    for wanted in (1, 2, 3):
        cpu.write("wanted", wanted.to_bytes(4, "little"))
        counts.append(cpu.call(name)[0])
    assert counts[2] - counts[1] == counts[1] - counts[0]
    return counts[0] + (CHIPS - 1) * (counts[1] - counts[0])


def rows(_: Bench) -> list[Row]:
    """Return the rows of the subject; what each finds is compared with the product of codes and samples."""
    if (sources := cmsis()) is None:
        return []
    with tempfile.TemporaryDirectory() as folder:
        cpu = machine(Path(folder), sources)
    expected = code_matrix(DEGREE, range(CHIPS)).astype(np.int64).T @ samples().astype(np.int64)
    ours, _stack = cpu.call("transform")
    cpu.write("wanted", CHIPS.to_bytes(4, "little"))
    cpu.call("read_out")
    assert np.array_equal(table(cpu), expected)
    turned = cpu.call("turn")[0]
    plain, dots = (turned + of_all(cpu, name) for name in ("plain", "dot_products"))
    for name in ("plain", "dot_products"):
        cpu.write("found", bytes(4 * AXES * CHIPS))
        cpu.write("wanted", (3).to_bytes(4, "little"))
        cpu.call(name)
        assert np.array_equal(table(cpu)[:3], expected[:3])
    cpu.call("fourier_init")
    fourier = turned + AXES * cpu.call("by_fourier")[0]
    nearly = np.frombuffer(cpu.read("found_by_fourier"), dtype=np.float32)[:CHIPS]
    assert np.allclose(nearly, expected[:, 0], atol=20.0)
    peer = f"CMSIS-DSP {sources.name.rpartition('-')[2]}"
    peers = {
        "plain correlation, gcc -O2": (plain, Goal("ratio", at_least=LEAST)),
        f"{peer}, arm_dot_prod_q15": (dots, None),
        f"{peer}, arm_rfft_fast_f32, not exact": (fourier, None),
    }
    what = "a cycle with 1,023 codes on three axes, Cortex-M4"
    return [
        Row(SUBJECT, what, "instructions", ours, name, theirs, theirs / ours, goal=goal)
        for name, (theirs, goal) in peers.items()
    ]


def table(cpu: Machine) -> np.ndarray:
    """Return what was found, shape (1023, 3)."""
    return np.frombuffer(cpu.read("found"), dtype=np.int32).reshape(AXES, CHIPS).T
