"""Instructions of the applications' handlers and main loops on a Cortex-M4 (Unicorn), without those of the board."""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from pathlib import Path

import pytest
import unicorn
from elftools.elf.elffile import ELFFile
from unicorn import arm_const as arm

from goldfield_protocol.parameters import Value, build_page
from hil_sim.clib import ROOT

FLAGS = (
    *("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-std=c11", "-O2"),
    *("-ffunction-sections", "-fdata-sections", "-nostartfiles", "--specs=nano.specs"),
    *("-Wl,--gc-sections,-e,0,--no-warn-rwx-segments", "-Ttext=0x08000000", "-Tdata=0x20000000"),
)
STACK, STOP = 0x20080000, 0x0803FF00

# A board that keeps the application's handlers; functions without arguments around each handler.
HARNESS = """
#include "apps/anchor.h"
#include "apps/beacon.h"
#include "apps/sensor.h"
struct hal { uint64_t us; } hal;
uint8_t page[HAL_PARAMETER_PAGE_BYTES] = {1};
hal_events_t events;
void hal_chips_start(hal_t *h, hal_role_t role, const hal_events_t *e) { (void)h; (void)role; events = *e; }
bool hal_drive_enable(hal_t *h, bool enable) { (void)h; (void)enable; return true; }
bool hal_drive_fault(const hal_t *h) { (void)h; return false; }
void hal_monitor(const hal_t *h, hal_monitor_t *m) {
    (void)h;
    *m = (hal_monitor_t){.supply = 2048, .coil = {2048, 2048}, .driver = 2048};
}
void hal_links_start(hal_t *h, uint32_t can, uint32_t serial) { (void)h; (void)can; (void)serial; }
bool hal_serial_write(hal_t *h, const uint8_t *bytes, size_t count) { (void)h; (void)bytes; (void)count; return true; }
void hal_serial_write_polled(hal_t *h, const uint8_t *bytes, size_t count) { (void)h; (void)bytes; (void)count; }
size_t hal_serial_read(hal_t *h, uint8_t *bytes, size_t capacity) { (void)h; (void)bytes; (void)capacity; return 0; }
bool hal_can_send(hal_t *h, const hal_frame_t *frame) { (void)h; (void)frame; return true; }
bool hal_can_receive(hal_t *h, hal_frame_t *frame) { (void)h; (void)frame; return false; }
bool hal_can_stamp(hal_t *h, hal_stamp_t *stamp) { (void)h; (void)stamp; return false; }
hal_clock_t hal_clock(const hal_t *h) { (void)h; return HAL_CLOCK_CRYSTAL; }
void hal_counters(const hal_t *h, hal_counters_t *c) { (void)h; *c = (hal_counters_t){0}; }
uint32_t asked_us = 0; /* The clock goes on by so much whenever it is asked. */
uint64_t hal_microseconds(hal_t *h) { return h->us += asked_us; }
int16_t hal_temperature(const hal_t *h) { (void)h; return 250; }
hal_burst_t hal_burst_timing(void) { return (hal_burst_t){14672, 216}; }
void hal_led(hal_t *h, bool on) { (void)h; (void)on; }
void hal_reset(hal_t *h) { (void)h; }
void hal_unique_id(const hal_t *h, uint8_t id[12]) { (void)h; for (int i = 0; i < 12; i++) id[i] = 0; }
const uint8_t *hal_parameter_page(const hal_t *h) { (void)h; return page; }
const uint32_t slots[2][HAL_FLASH_WORDS] = {[0 ... 1] = {[0 ... HAL_FLASH_WORDS - 1] = UINT32_MAX}};
const uint32_t *hal_flash_slot(const hal_t *h, uint32_t slot) { (void)h; return slots[slot]; }
bool hal_flash_program(hal_t *h, uint32_t slot, uint32_t index, uint32_t value) {
    (void)h; (void)slot; (void)index; (void)value;
    return false;
}
bool hal_random(hal_t *h, uint64_t *number) { (void)h; (void)number; return false; }
bool hal_flash_erase(hal_t *h, uint32_t slot) { (void)h; (void)slot; return false; }
hal_images_t hal_images(const hal_t *h) { (void)h; return (hal_images_t){0}; }
bool hal_image_program(hal_t *h, uint32_t slot, uint32_t index, uint32_t value) {
    (void)h; (void)slot; (void)index; (void)value; return false;
}
bool hal_image_erase(hal_t *h, uint32_t slot, uint32_t words) { (void)h; (void)slot; (void)words; return false; }
void hal_watchdog_kick(hal_t *h) { (void)h; }
uint32_t hal_serial_waiting(const hal_t *h) { (void)h; return 0; }
void hal_note_stalled(hal_t *h, uint32_t stalled) { (void)h; (void)stalled; }
const hal_reset_t *hal_last_reset(const hal_t *h) { static const hal_reset_t r; (void)h; return &r; }
uint32_t *hal_retained(hal_t *h) { static uint32_t words[HAL_RETAINED_WORDS]; (void)h; return words; }

beacon_t beacon;
sensor_t sensor;
anchor_t anchor;
acquire_t acquire;
onboard_t onboard;
tracking_t tracking;
hal_plan_t plans[2];
hal_samples_t samples;
uint32_t block = 0, chip = 0, count = 2048;
void begin_beacon(void) { beacon_start(&beacon, &hal); }
static void fill_samples(void) {
    for (uint32_t i = 0; i < sizeof samples / 2; i++) (&samples[0][0][0])[i] = (uint16_t)(1 + i * 37 % 4094);
}
void begin_sensor(void) { sensor_start(&sensor, &acquire, &onboard, &tracking, &hal); fill_samples(); }
void begin_anchor(void) { anchor_start(&anchor, &onboard, &tracking, &hal); fill_samples(); }
void call_plan(void) { events.plan(events.context, block, &plans[block & 1]); block++; hal.us += 3030; }
static uint16_t sensed(uint32_t drive, uint32_t set_point) {
    const uint32_t size = set_point / 2u;
    return (uint16_t)(2048u + (drive == HAL_DRIVE_POSITIVE ? size : drive == HAL_DRIVE_NEGATIVE ? 0u - size : 0u));
}
uint16_t now[2] = {2048, 2048}, early[2]; /* Behind the edge a quarter of the way is done. */
void sense_current(void) {
    const hal_plan_t *plan = &plans[chip / HAL_BLOCK_CHIPS & 1];
    const uint32_t i = chip % HAL_BLOCK_CHIPS;
    const uint16_t before[2] = {now[0], now[1]};
    now[0] = sensed(plan->drive[i] & 3u, plan->set_point[0][i]);
    now[1] = sensed(plan->drive[i] >> 2 & 3u, plan->set_point[1][i]);
    for (uint32_t c = 0; c < 2u; c++) early[c] = (uint16_t)((3u * before[c] + now[c]) / 4u);
}
void call_edge(void) { events.edge(events.context, chip, early); }
void call_middle(void) { events.middle(events.context, chip, now); }
void call_current(void) { events.current(events.context, chip++, now); }
void call_samples(void) { events.samples(events.context, block - 2, (const hal_samples_t *)&samples); }
void lock(void) { sensor.timing.clock.locked = true; }
void step_beacon(void) { beacon_step(&beacon); }
void step_sensor(void) { sensor_step(&sensor); }
void step_anchor(void) { anchor_step(&anchor); }
"""


class Machine:
    """Calls functions of the harness on a Cortex-M4."""

    def __init__(self, machine: unicorn.Uc, symbols: Mapping[str, int]) -> None:
        self._machine, self._symbols = machine, symbols
        self._count, self._hook = 0, 0

    def __call__(self, name: str) -> int:
        """Return the instructions of a call."""
        if not self._hook:
            self._hook = self._machine.hook_add(unicorn.UC_HOOK_CODE, self._step)
            self._machine.ctl_flush_tb()  # what was translated before does not know of the hook
        self._count = 0
        self._run(name)
        return self._count

    def uncounted(self, name: str) -> None:
        """Call a function whose instructions nobody asks for, many times as fast."""
        if self._hook:
            self._machine.hook_del(self._hook)
            self._machine.ctl_flush_tb()
            self._hook = 0
        self._run(name)

    def _run(self, name: str) -> None:
        self._machine.reg_write(arm.UC_ARM_REG_SP, STACK)
        self._machine.reg_write(arm.UC_ARM_REG_LR, STOP | 1)
        self._machine.emu_start(self._symbols[name] | 1, STOP)

    def _step(self, *_: object) -> None:
        self._count += 1


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("instructions")
    source, elf = directory / "harness.c", directory / "apps.elf"
    source.write_text(HARNESS)
    built, folders = ROOT / "build/firmware", ("apps", "services", "core/*", "third_party/*")
    objects = [path for folder in folders for path in sorted((built / "firmware").glob(f"{folder}/*.o"))]
    includes = [f"-I{ROOT / path}" for path in ("firmware", "build/protocol")]
    sources = [source, *objects, built / "protocol/goldfield.o"]
    keep = (
        "begin_beacon",
        "begin_sensor",
        "lock",
        "call_plan",
        "sense_current",
        "call_edge",
        "call_middle",
        "call_current",
        "call_samples",
    )
    keep += ("begin_anchor", "step_beacon", "step_sensor", "step_anchor")
    undefined = [f"-Wl,-u,{name}" for name in keep]
    subprocess.run(["arm-none-eabi-gcc", *FLAGS, *includes, *map(str, sources), *undefined, "-o", str(elf)], check=True)
    return elf


@pytest.fixture
def call(image: Path, request: pytest.FixtureRequest) -> Machine:
    """The image on a machine; each test has its own memory."""
    machine = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB)
    machine.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
    machine.mem_map(0x08000000, 0x40000)
    machine.mem_map(0x20000000, 0x80000)  # three applications in one
    symbols = {}
    with image.open("rb") as file:
        loaded = ELFFile(file)
        for segment in loaded.iter_segments("PT_LOAD"):
            machine.mem_write(segment["p_vaddr"], segment.data())
        for symbol in loaded.get_section_by_name(".symtab").iter_symbols():
            symbols[symbol.name] = symbol["st_value"]
    codes = list(range(2, 10))
    values: dict[str, Value] = {
        "node": 1,
        "code": 2,
        "amplitude": 10.0,
        "sync_master": 1,
        "code_count": 8,
        "code_list": codes,
    }
    machine.mem_write(symbols["page"], build_page(values | getattr(request, "param", {})))
    machine.reg_write(arm.UC_ARM_REG_C1_C0_2, 0xF << 20)
    machine.reg_write(arm.UC_ARM_REG_FPEXC, 1 << 30)
    return Machine(machine, symbols)


def look_for_a_leader(call: Machine, step: str) -> int:
    """Let a board with a rank look for a leader until it leads itself; return its idle turn's instructions.

    By then CAN, which takes nothing here, counts as dead: trying it costs each idle turn 35 instructions more.
    """
    for _ in range(2):
        call("call_plan")
    for _ in range(40):
        call.uncounted("call_plan")
        call.uncounted(step)
        call.uncounted(step)
    idle = int(call(step))
    for _ in range(120):
        call.uncounted("call_plan")
        call.uncounted(step)
    return idle


@pytest.mark.parametrize(
    ("call", "most"),
    [({}, (150, 260, 620, 230, 175)), ({"waveform": 3, "periods": 5, "degree": 11}, (215, 335, 700, 300, 260))],
    indirect=["call"],
)
def test_beacon(call: Machine, most: tuple[int, int, int, int, int]) -> None:
    start = call("begin_beacon")
    plans, edges, middles, currents, idle, reports = [], [], [], [], [], []
    listening = look_for_a_leader(call, "step_beacon")
    for _ in range(70):
        for _ in range(31):
            call("sense_current")
            edges.append(call("call_edge"))
            middles.append(call("call_middle"))
            currents.append(call("call_current"))
        plans.append(call("call_plan"))
        reports.append(call("step_beacon"))
        idle.append(call("step_beacon"))
    chip, chip_most = sorted(currents)[len(currents) // 2], max(currents)
    edge = sorted(edges)[len(edges) // 2]
    print(f"beacon: start {start}, plan of 31 chips {max(plans)}, current {chip}, at most {chip_most}")
    print(f"        behind an edge {edge}, at most {max(edges)}, amid the chip {max(middles)}")
    print(f"        main idle {min(idle)}, with a report {max(reports)} instructions")
    assert max(plans) <= 31 * most[0]
    assert chip <= most[1]
    assert chip_most <= most[2]
    assert max(edges) <= most[3]
    assert max(middles) <= most[4]
    assert min(idle) <= 425
    assert listening <= 600


def test_sensor(call: Machine) -> None:
    start = call("begin_sensor")
    plans, samples, idle, reports = [], [], [], []
    for _ in range(2):
        call("call_plan")
    for _ in range(70):
        samples.append(call("call_samples"))
        plans.append(call("call_plan"))
        reports.append(call("step_sensor"))
        idle.append(call("step_sensor"))
    print(f"sensor: start {start}, plan of 31 chips {max(plans)}, samples of 31 chips {max(samples)}")
    print(f"        main idle {min(idle)}, with a report of 8 codes {max(reports)} instructions")
    assert max(samples) <= 31 * 600
    assert max(plans) <= 31 * 70
    assert min(idle) <= 310
    assert max(reports) <= 110_000


@pytest.mark.parametrize("call", [{"sync_source": 1}], indirect=True)
def test_sensor_that_follows_the_field(call: Machine) -> None:
    call.uncounted("begin_sensor")
    for _ in range(2):
        call.uncounted("call_plan")
    samples = []
    for _ in range(200):
        samples.append(call("call_samples"))
        call.uncounted("call_plan")
        call.uncounted("step_sensor")
    print(f"sensor by the field: samples of 31 chips {max(samples)}")
    assert max(samples) <= 31 * 600


@pytest.mark.parametrize("call", [{"waveform": 3, "periods": 5}], indirect=True)
def test_anchor_with_two_channels(call: Machine) -> None:
    start = call("begin_anchor")
    samples, currents, plans, reports, idle = [], [], [], [], []
    look_for_a_leader(call, "step_anchor")
    for _ in range(70):
        for _ in range(31):
            call("sense_current")
            currents.append(call("call_current"))
        samples.append(call("call_samples"))
        plans.append(call("call_plan"))
        reports.append(call("step_anchor"))
        idle.append(call("step_anchor"))
    block = max(samples) + max(plans) + 30 * sorted(currents)[len(currents) // 2] + max(currents)
    print(f"anchor: start {start}, samples and plan of a block {max(samples)} + {max(plans)}, with currents {block}")
    print(f"        main idle {min(idle)}, with a report of 8 codes {max(reports)} instructions")
    assert block <= 30_000  # A block lasts 509,000 ticks.
    assert min(idle) <= 570
    assert max(reports) <= 110_000


@pytest.mark.parametrize("call", [{"blocks": 3}], indirect=True)
def test_sensor_that_sends_blocks(call: Machine) -> None:
    """The clock counts as locked with the first edge of the wire."""
    call.uncounted("begin_sensor")
    call.uncounted("lock")
    for _ in range(2):
        call.uncounted("call_plan")
    samples, main = [], []
    for _ in range(68):
        samples.append(call("call_samples"))
        call.uncounted("call_plan")
        main.append(call("step_sensor"))
    block = sorted(main)[len(main) // 2]
    print(f"sensor with blocks: samples of 31 chips at most {max(samples)}, main for a block of 8 codes {block}")
    assert max(samples) <= 31 * 600
    assert 10_000 < block <= 24_000
