"""Instruction counts on a Cortex-M4 (Unicorn), with the compiler and the optimisation of the image."""

import struct
import subprocess

import numpy as np
import pytest
import unicorn
from elftools.elf.elffile import ELFFile
from unicorn import arm_const as arm

from hil_sim.clib import ROOT

FLAGS = (
    *("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"),
    *("-std=c11", "-O2", "-ffreestanding"),
)
OF_OTHERS = {"boot", "challenge.c"}
"""What stands on the code of others, and is left out: a folder, and a file."""
RAM, STACK, STOP = 0x20000000, 0x20040000, 0x0801FF00

# Plain functions with word arguments around the calls that take structs or start from known states.
HARNESS = """
#include "core/timing/chip_clock.h"
#include "core/codes/block_sums.h"
#include "core/drive/current.h"
#include "core/codes/despread.h"
#include "core/codes/epoch.h"
#include "core/codes/strongest.h"
#include "core/link/frame.h"
#include "core/codes/gold.h"
#include "core/link/parameters.h"
#include "core/link/queue.h"
#include "core/drive/waveform.h"
despread_t cycle;
int16_t sample[3] = {-32768, 5, 32767};
void start(void) { despread_start(&cycle, gold_family(10)); }
void store(void) { despread_store(&cycle, sample); }
void transform(void) { despread_transform(&cycle); }
int32_t word(void) { return despread_word(gold_family(10), 1022); }
int32_t correlation(void) { return despread_correlation(&cycle, 1, 17); }
uint16_t burst[8][3];
int32_t burst_sample(void) { return epoch_sample((const uint16_t (*)[3])burst, sample); }
epoch_collector_t collector;
void collect(void) { epoch_init(&collector, gold_family(10)); }
uint32_t chip;
int32_t feed(void) {
    uint32_t t = chip++;
    return epoch_feed(&collector, t, t / 1023u, (uint16_t)(t % 1023u), sample, false, true);
}
chip_clock_t clock;
void clock_init(void) {
    chip_clock_init(&clock, &(chip_clock_config_t){1023, 16422, 16000, 16900, true});
    for (int i = 0; i < 62; i++) chip_clock_plan(&clock);
}
void clock_plan(void) { chip_clock_plan(&clock); }
void clock_cycle(void) { for (int i = 0; i < 1023; i++) chip_clock_plan(&clock); }
void clock_edge(void) { chip_clock_edge(&clock, clock.chip - 40u, 3); }
void clock_message(void) {
    chip_clock_mark_t mark;
    chip_clock_mark(&clock, clock.chip - 40u, 3, &mark);
    chip_clock_message(&clock, &mark, 1000);
}
current_t loop;
void loop_init(void) {
    current_configure(&loop, &(current_config_t){.sense_A = 0.0078125f, .reference_A = 0.00390625f,
        .amplitude_A = 10.0f, .open_fraction = 0.5f,
        .guard = {.over_current_A = 12.0f, .rms_A = 12.0f, .rms_chips = 1e5f}});
    for (int i = 0; i < 300; i++) current_sample(&loop, false, 0, 2048u);
    current_start(&loop);
}
int32_t loop_sample(void) {
    return current_sample(&loop, true, (int16_t)-loop.reference, (uint16_t)(2048u - loop.reference / 2u)) != CAUSE_NONE;
}
waveform_t waveform;
int16_t level[WAVEFORM_CHANNELS];
const waveform_config_t rotating_field = {.kind = WAVEFORM_ROTATING, .periods = 5};
const waveform_config_t four = {
    .kind = WAVEFORM_SUPERPOSED,
    .codes = {{10, 1, 0, 1}, {10, 2, 5, 1}, {5, 1, 0, 3}, {5, 2, 0, 33}},
};
const waveform_config_t one = {.kind = WAVEFORM_CODE, .code = 2};
void rotating(void) { waveform_start(&waveform, 11, &rotating_field); }
void four_codes(void) { waveform_start(&waveform, 10, &four); }
void one_code(void) { waveform_start(&waveform, 10, &one); }
void chip_level(void) { waveform_next(&waveform, level); }
uint8_t encoded[16];
frame_t frame = {0x1FFFFFFF, 8, {1, 2, 3, 4, 5, 6, 7, 8}};
int32_t encode(void) { return (int32_t)frame_encode(&frame, encoded); }
frame_decoder_t decoder;
int32_t decode(void) {
    int32_t good = 0;
    for (int i = 0; i < 16; i++) good = frame_decode(&decoder, encoded[i], &frame);
    return good;
}
int32_t code_sum(void) { return gold_sum(10, 5); }
epoch_calibration_t calibration = {{2048, 2048, 2048}, {{1e-7f, 0, 0}, {0, 1e-7f, 0}, {0, 0, 1e-7f}}};
epoch_selection_t selection = {1, {{5, 17, -1}}};
epoch_sums_t sums = {.chips = 1023};
float field[3];
void one_field(void) { epoch_field(&sums, &calibration, &selection, 0, field); }
code_bits_t code_bits;
block_collector_t blocks;
block_sums_t of_block;
uint32_t block_chip;
void blocks_init(void) {
    code_bits_init(&code_bits, gold_family(10));
    block_collect_init(&blocks, 1023);
    for (uint32_t i = 0; i < 8u; i++) selection.codes[i].code = (uint16_t)(2u + i);
}
void block_chips(void) {
    block_collect(&blocks, block_chip, 0, block_chip % 1023u, sample, 0, true);
    block_chip++;
}
uint32_t code_word(void) { return code_bits_at(&code_bits, 1000, 1022); }
void sums_of_0(void) {
    selection.count = 0;
    block_sums(block_ready(&blocks), &code_bits, &selection, &calibration, &of_block);
}
void sums_of_8(void) {
    selection.count = 8;
    block_sums(block_ready(&blocks), &code_bits, &selection, &calibration, &of_block);
}
strongest_t chooser;
epoch_selection_t chosen;
void chooser_init(void) { strongest_init(&chooser, gold_family(10), &cycle); }
void chooser_clear(void) { strongest_clear(&chooser, &chosen); }
void choose_8(void) { (void)strongest_choose(&chooser, &cycle, 8, &chosen); }
void choose_64(void) { (void)strongest_choose(&chooser, &cycle, 64, &chosen); }
uint32_t chosen_count(void) { return chosen.count; }
"""


@pytest.fixture(scope="module")
def count(tmp_path_factory):
    """Call a function of the harness: (instructions, r0)."""
    directory = tmp_path_factory.mktemp("instructions")
    source, elf = directory / "harness.c", directory / "core.elf"
    source.write_text(HARNESS)
    core = [
        path for path in sorted((ROOT / "firmware/core").glob("*/*.c")) if not OF_OTHERS & {path.parent.name, path.name}
    ]
    layout = (
        "-Ttext=0x08000000",
        f"-Tdata={RAM:#x}",
        "-nostartfiles",
        "--specs=nano.specs",
        "-Wl,-e,0,--no-warn-rwx-segments",
    )
    command = [
        "arm-none-eabi-gcc",
        *FLAGS,
        f"-I{ROOT / 'firmware'}",
        f"-I{ROOT / 'build/protocol'}",
        str(source),
        *map(str, core),
        *layout,
        "-o",
        str(elf),
    ]
    subprocess.run(command, check=True)
    machine = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB)
    machine.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
    machine.mem_map(0x08000000, 0x20000)
    machine.mem_map(RAM, 0x40000)
    symbols = {}
    with elf.open("rb") as file:
        loaded = ELFFile(file)
        for segment in loaded.iter_segments("PT_LOAD"):
            machine.mem_write(segment["p_vaddr"], segment.data())
        for symbol in loaded.get_section_by_name(".symtab").iter_symbols():
            symbols[symbol.name] = symbol["st_value"]
    machine.reg_write(arm.UC_ARM_REG_C1_C0_2, 0xF << 20)
    machine.reg_write(arm.UC_ARM_REG_FPEXC, 1 << 30)
    total = [0]

    def step(*_):
        total[0] += 1

    machine.hook_add(unicorn.UC_HOOK_CODE, step)

    def call(name):
        total[0] = 0
        machine.reg_write(arm.UC_ARM_REG_SP, STACK)
        machine.reg_write(arm.UC_ARM_REG_LR, STOP | 1)
        machine.emu_start(symbols[name] | 1, STOP)
        return total[0], machine.reg_read(arm.UC_ARM_REG_R0)

    call.memory = lambda name, size: bytes(machine.mem_read(symbols[name], size))
    call.write = lambda name, offset, data: machine.mem_write(symbols[name] + offset, data)
    return call


def test_three_axes_despread_within_90000(count, core, gold_family):
    count("start")
    for _ in range(1023):
        stored, _ = count("store")
    instructions, _ = count("transform")
    print(f"despread_store {stored}, despread_transform {instructions} instructions for three axes")
    words = np.array(struct.unpack("<6144i", count.memory("cycle", 24576))).reshape(3, 2048)[:, :1024]
    # The samples are constant: each word is a code's sum times the sample.
    expected = np.outer([-32768, 5, 32767], gold_family(10)[:1024].sum(axis=1))
    _, lib = core
    addresses = [lib.despread_word(lib.gold_family(10), code) for code in range(1024)]
    assert np.array_equal(words[:, addresses], expected)
    assert instructions <= 90_000
    assert stored <= 100


def test_each_call_within_what_its_header_says(count):
    figures = {}
    count("start")
    count("collect")
    count("clock_init")
    count("loop_init")
    for name in ("word", "correlation", "burst_sample", "feed", "clock_plan", "encode", "code_sum", "one_field"):
        figures[name], _ = count(name)
    figures["decode"], good = count("decode")
    assert good == 1
    for call in ("clock_edge", "clock_message"):
        edges = []
        for _ in range(6):
            edges.append(count(call)[0])
            count("clock_cycle")
        figures[call] = max(edges)
    samples = [count("loop_sample") for _ in range(31 * 40)]
    assert not any(off for _, off in samples)  # No fault: this is the running loop.
    counts = sorted(n for n, _ in samples)
    figures["current_sample"], figures["current_sample_block"] = counts[len(counts) // 2], counts[-1]
    for name in ("one_code", "rotating", "four_codes"):
        count(name)
        figures[name] = max(count("chip_level")[0] for _ in range(40))
    figures["blocks_init"], _ = count("blocks_init")
    figures["block_chips"] = max(count("block_chips")[0] for _ in range(62))
    for name in ("code_word", "sums_of_0", "sums_of_8"):
        figures[name], _ = count(name)
    print(figures)
    bounds = {
        **{"blocks_init": 45_000, "block_chips": 85, "code_word": 50, "sums_of_0": 760, "sums_of_8": 4300},
        **{"word": 2500, "correlation": 20, "burst_sample": 270, "feed": 220, "clock_plan": 70, "clock_edge": 720},
        "clock_message": 1050,
        **{"encode": 500, "decode": 900, "code_sum": 50_000, "one_field": 240, "current_sample": 140},
        **{"current_sample_block": 470, "one_code": 100, "rotating": 120, "four_codes": 275},
    }
    assert {name: n for name, n in figures.items() if n > bounds[name]} == {}


def write_cycle(count, core, chips, samples):
    """Write what despread_transform makes of samples, shape (N, 3)."""
    _, lib = core
    words = np.zeros((3, 2048), dtype=np.int32)
    addresses = [lib.despread_word(lib.gold_family(10), code) for code in range(1024)]
    words[:, addresses] = (chips[:1024] @ samples).T
    count.write("cycle", 0, words.tobytes())
    count.write("cycle", 24576 + 4 + 12, samples.sum(axis=0).astype(np.int32).tobytes())  # family, v_sum, sum


@pytest.mark.parametrize(("most", "steady", "first"), [(8, 74_000, 194_000), (64, 77_000, 370_000)])
def test_choice_of_the_strongest(count, core, gold_family, most, steady, first):
    """The first cycle, in which all come, and one in which nothing changes; then codes that grow with their number."""
    rng, chips = np.random.default_rng(1), gold_family(10)
    noise = np.rint(rng.normal(0, 30, (1023, 3))).astype(np.int64)
    started, _ = count("chooser_init")
    cleared, _ = count("chooser_clear")
    sizes = 3000.0 / (1 + np.arange(most) / 8) ** 3
    samples = noise + np.rint(chips[rng.permutation(1024)[:most]].T @ np.outer(sizes, [1, 0.3, -0.2])).astype(np.int64)
    write_cycle(count, core, chips, samples)
    come, _ = count(f"choose_{most}")
    count(f"choose_{most}")
    stay, _ = count(f"choose_{most}")
    heard = count("chosen_count")[1]
    count("chooser_clear")
    growing = noise + np.rint(chips[750:1000].T @ np.outer(4.0 * 1.012 ** np.arange(250), [1, 1, 1])).astype(np.int64)
    write_cycle(count, core, chips, growing)
    dearest, _ = count(f"choose_{most}")
    print(f"strongest {most}: init {started}, clear {cleared}, all come {come}, steady {stay} with {heard} codes")
    print(f"              250 codes that grow {dearest}")
    assert heard > most // 2
    assert started <= 180_000
    assert stay <= steady
    assert come <= first
    assert dearest <= 260_000
