"""Draw docs/hardware/driver.svg and sensor.svg: ``make circuit-diagrams``. The nets are those of the netlists."""

from __future__ import annotations

import sys
from pathlib import Path

from tests.bench.circuit_symbols import Sheet

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "hardware"


def _gate(sheet: Sheet, x: float, y: float, driver: str, resistor: str, net: str) -> None:
    """Draw what drives a gate whose transistor's gate lies at a point: the net, its driver, its resistor."""
    sheet.resistor(x - 30, y, resistor, "4.7")
    sheet.box(x - 150, y - 17, driver, "Si8235", (90, 34))
    sheet.net(x - 150, y, net, left=True)


def power(sheet: Sheet) -> None:
    """Draw boost, hold, bridge, shunts and snubbers."""
    sheet.text(20, 30, "Power: one channel; two on a board", kind="head")
    sheet.net(330, 60, "hv (120 V)", left=True)
    sheet.wire((330, 60), (560, 60), (560, 80))
    sheet.wire((440, 60), (440, 70))
    sheet.dot(440, 60)
    sheet.capacitor(440, 100, "C1", "470 uF 200 V", upright=True)
    sheet.ground(440, 130)
    sheet.transistor(560, 110, "Q5", "IRFP260N")
    _gate(sheet, 526, 180, "U13", "R31", "boost")
    sheet.wire((526, 180), (526, 110))
    sheet.wire((560, 140), (560, 230))
    sheet.net(800, 190, "lv (5 V)")
    sheet.diode(770, 190, "D1", "MBR40250", turn=180)
    sheet.wire((740, 190), (560, 190))
    sheet.dot(560, 190)
    sheet.wire((380, 230), (800, 230))
    sheet.dot(560, 230)
    sheet.text(640, 224, "top", kind="net")
    for x, upper, lower, shunt, tag in ((380, "Q1", "Q2", "R2", "a"), (800, "Q3", "Q4", "R3", "b")):
        side = "A" if tag == "a" else "B"
        pins = {"a": ("R27", "R28"), "b": ("R29", "R30")}[tag]
        sheet.wire((x, 230), (x, 250))
        sheet.transistor(x, 280, upper, "IRFP260N")
        _gate(sheet, x - 34, 280, f"U11{side}", pins[0], f"upper_{tag}_on")
        sheet.wire((x, 310), (x, 350))
        sheet.dot(x, 350)
        sheet.transistor(x, 400, lower, "IRFP260N")
        sheet.wire((x, 350), (x, 370))
        _gate(sheet, x - 34, 400, f"U12{side}", pins[1], f"lower_{tag}_on")
        sheet.wire((x, 430), (x, 450))
        sheet.dot(x, 440)
        sheet.net(x + 8, 440, f"shunt_{tag}")
        sheet.resistor(x, 480, shunt, "10 mOhm", upright=True)
        sheet.ground(x, 510)
    sheet.wire((380, 350), (530, 350))
    sheet.wire((800, 350), (590, 350))
    sheet.coil(560, 350, "coil", "190 uH, 0.15 Ohm")
    for x, capacitor, resistor in ((470, "C2", "R4"), (910, "C3", "R5")):
        sheet.wire((x, 350), (x, 370))
        sheet.capacitor(x, 400, capacitor, "10 nF", upright=True)
        sheet.resistor(x, 460, resistor, "220", upright=True)
        sheet.ground(x, 490)
    sheet.dot(470, 350)
    sheet.wire((800, 350), (910, 350))
    sheet.net(400, 342, "coil_a")
    sheet.net(740, 342, "coil_b")


def sense(sheet: Sheet) -> None:
    """Draw the current sense and its reference."""
    sheet.text(20, 580, "Current sense: 1.65 V + 0.103125 V/A", kind="head")
    for y, shunt, on, off, resistor, pins in (
        (620, "shunt_b", "not_reverse", "reverse", "R6", "U1A, U1B"),
        (690, "shunt_a", "not_forward", "forward", "R8", "U1C, U1D"),
    ):
        sheet.net(75, y, shunt, left=True)
        sheet.wire((75, y), (90, y))
        sheet.box(90, y - 22, pins, f"{on} / {off}", (150, 44))
        sheet.resistor(270, y, resistor, "1.6k")
    sheet.text(165, y + 38, "one switch to the shunt, one to ground", anchor="middle")
    sheet.amplifier(400, 655, "U2A", "OPA2192")
    sheet.wire((300, 620), (330, 620), (330, 640), (360, 640))
    sheet.wire((300, 690), (330, 690), (330, 670), (360, 670))
    sheet.dot(330, 620)
    sheet.dot(330, 690)
    sheet.wire((330, 620), (330, 585), (340, 585))
    sheet.resistor(370, 585, "R7", "16.5k")
    sheet.net(400, 585, "ref165")
    sheet.wire((330, 690), (330, 735), (360, 735))
    sheet.resistor(390, 735, "R9", "16.5k")
    sheet.wire((420, 735), (460, 735), (460, 655))
    sheet.wire((440, 655), (480, 655))
    sheet.dot(460, 655)
    sheet.net(460, 705, "sense_amp")
    sheet.resistor(510, 655, "R10", "1k")
    sheet.wire((540, 655), (720, 655))
    sheet.net(720, 655, "sense (PA0, PC4)")
    for x in (560, 610, 670):
        sheet.dot(x, 655)
    sheet.capacitor(560, 685, "C4", "22 pF", upright=True)
    sheet.ground(560, 715)
    sheet.diode(610, 625, "D2", "BAT54", turn=-90)
    sheet.net(610, 592, "3.3 V")
    sheet.diode(670, 685, "D3", "BAT54", turn=-90)
    sheet.ground(670, 715)
    sheet.net(790, 620, "3.3 V", left=True)
    sheet.resistor(820, 620, "R11", "10k")
    sheet.wire((850, 620), (890, 620))
    sheet.dot(852, 620)
    sheet.wire((852, 620), (852, 640))
    sheet.resistor(852, 670, "R12", "", upright=True)
    sheet.text(864, 712, "10k")
    sheet.ground(852, 700)
    sheet.amplifier(930, 635, "U2B", "OPA2192")
    sheet.wire((890, 650), (890, 690), (985, 690), (985, 635))
    sheet.wire((970, 635), (1000, 635))
    sheet.net(1000, 635, "ref165")


def target(sheet: Sheet) -> None:
    """Draw the set-point's way to the target."""
    sheet.text(20, 775, "Target: 1.65 V or 1.65 V +- setpoint / 2", kind="head")
    sheet.net(120, 830, "setpoint (PA4, PA5)", left=True)
    sheet.wire((120, 830), (150, 830))
    sheet.dot(124, 830)
    sheet.resistor(124, 870, "R13", "", upright=True)
    sheet.wire((124, 830), (124, 840))
    sheet.text(88, 874, "10M")
    sheet.ground(124, 900)
    sheet.amplifier(190, 845, "U3A", "OPA2192")
    sheet.wire((150, 860), (150, 900), (240, 900), (240, 845), (230, 845))
    sheet.wire((240, 845), (270, 845))
    sheet.net(236, 835, "sp")
    sheet.resistor(300, 845, "R15", "10k")
    sheet.net(270, 800, "3.3 V", left=True)
    sheet.resistor(300, 800, "R14", "10k")
    sheet.wire((330, 800), (345, 800), (345, 845))
    sheet.wire((330, 845), (360, 845))
    sheet.dot(345, 845)
    sheet.amplifier(400, 860, "U3B", "OPA2192")
    sheet.wire((360, 875), (360, 910), (450, 910), (450, 860), (440, 860))
    sheet.wire((450, 860), (480, 860))
    sheet.net(448, 850, "positive")
    sheet.resistor(510, 860, "R16", "10k")
    sheet.amplifier(620, 845, "U4A", "OPA2192")
    sheet.wire((540, 860), (580, 860))
    sheet.dot(565, 860)
    sheet.net(580, 830, "ref165", left=True)
    sheet.wire((565, 860), (565, 905), (590, 905))
    sheet.resistor(620, 905, "R17", "10k")
    sheet.wire((650, 905), (675, 905), (675, 845), (660, 845))
    sheet.wire((675, 845), (690, 845))
    sheet.net(690, 845, "negative")
    for k, (pin, net, by) in enumerate(
        (("U5A", "positive", "want_p"), ("U5B", "negative", "want_n"), ("U5C", "ref165", "want_0"))
    ):
        y = 805 + 42 * k
        sheet.net(840, y, net, left=True)
        sheet.box(840, y - 17, pin, f"ADG1412, {by}", (120, 34))
        sheet.wire((960, y), (985, y))
    sheet.wire((985, 805), (985, 900))
    sheet.dot(985, 847)
    sheet.wire((985, 847), (1010, 847))
    sheet.net(1010, 847, "target")
    sheet.wire((985, 900), (985, 905))
    sheet.capacitor(985, 935, "C5", "100 pF", upright=True)
    sheet.ground(985, 965)


def error(sheet: Sheet) -> None:
    """Draw the error amplifier and its comparators."""
    sheet.text(20, 970, "Error: 1.65 V + 10 (target - sense)", kind="head")
    sheet.net(90, 1030, "target", left=True)
    sheet.resistor(120, 1030, "R18", "10k")
    sheet.wire((150, 1030), (240, 1030))
    sheet.dot(200, 1030)
    sheet.wire((200, 1030), (200, 1000), (210, 1000))
    sheet.resistor(240, 1000, "R19", "")
    sheet.text(270, 992, "100k")
    sheet.net(270, 1000, "ref165")
    sheet.net(90, 1080, "sense_amp", left=True)
    sheet.resistor(120, 1080, "R20", "10k")
    sheet.wire((150, 1080), (220, 1080), (220, 1060), (240, 1060))
    sheet.wire((90, 1080), (90, 1140))
    sheet.capacitor(120, 1140, "C9", "33 pF")
    sheet.wire((150, 1140), (165, 1140), (165, 1080))
    sheet.dot(90, 1080)
    sheet.dot(165, 1080)
    sheet.amplifier(280, 1045, "U4B", "OPA2192")
    sheet.dot(220, 1080)
    sheet.wire((220, 1080), (220, 1110), (250, 1110))
    sheet.resistor(280, 1110, "R21", "100k")
    sheet.wire((310, 1110), (335, 1110), (335, 1045), (320, 1045))
    sheet.wire((335, 1045), (350, 1045))
    sheet.resistor(380, 1045, "R22", "1k")
    sheet.wire((410, 1045), (520, 1045))
    sheet.net(520, 1045, "error")
    sheet.dot(430, 1045)
    sheet.dot(480, 1045)
    sheet.diode(430, 1015, "D4", "BAT54", turn=-90)
    sheet.net(430, 985, "3.3 V")
    sheet.diode(480, 1075, "D5", "BAT54", turn=-90)
    sheet.ground(480, 1105)
    for y, part, value in ((1010, "R23", "10k"), (1070, "R24", "2.61k"), (1130, "R25", "10k")):
        sheet.resistor(640, y, part, value, upright=True)
    sheet.net(640, 978, "3.3 V")
    sheet.ground(640, 1160)
    sheet.wire((640, 1040), (700, 1040))
    sheet.net(700, 1040, "more_than")
    sheet.wire((640, 1100), (700, 1100))
    sheet.net(700, 1100, "less_than")
    for k, (part, plus, minus, out) in enumerate(
        (
            ("U6A", "error", "more_than", "low"),
            ("U6B", "less_than", "error", "high"),
            ("U7A", "error", "ref165", "more"),
        )
    ):
        y = 1010 + 75 * k
        sheet.amplifier(900, y, part, "TLV3502")
        sheet.net(860, y - 15, plus, left=True)
        sheet.net(860, y + 15, minus, left=True)
        sheet.net(940, y, out)


LOGIC = (
    "want_p = in1 & !in2          want_n = in2 & !in1          want_0 = !(want_p | want_n)",
    "ok = enable & !latch",
    "up = low & ok & !rest        down = high & ok & !rest     boost = up | down",
    "forward = up | (want_p & ok & !down)                      reverse = down | (want_n & ok & !up)",
    "upper_a = forward & (up | more)        lower_a = reverse | (forward & !up & !more)",
    "upper_b = reverse & (down | !more)     lower_b = forward | (reverse & !down & more)",
    "NAME_on = NAME, its rising edge later by the dead time of U10; a falling edge passes at once",
    "rest: 3 us after each end of boost (U9; R26 and C6 with D6 set them)",
)


def logic(sheet: Sheet) -> None:
    """Draw logic, dead time, and over-current."""
    sheet.text(20, 1220, "Logic", kind="head")
    sheet.box(20, 1240, "U8", "ATF1502AS, 5 V", (120, 44))
    sheet.box(20, 1300, "U9", "74LVC1G123", (120, 44))
    sheet.box(20, 1360, "U10", "74LVC14, 1k, 470 pF, BAT54", (170, 44))
    for k, line in enumerate(LOGIC):
        sheet.text(210, 1250 + 19 * k, line, kind="mono")
    sheet.net(770, 1385, "boost", left=True)
    sheet.diode(800, 1385, "D6", "BAT54")
    sheet.wire((830, 1385), (960, 1385))
    sheet.capacitor(850, 1415, "C6", "1 nF", upright=True)
    sheet.resistor(920, 1415, "R26", "4.3k", upright=True)
    sheet.ground(850, 1445)
    sheet.ground(920, 1445)
    sheet.dot(850, 1385)
    sheet.dot(920, 1385)
    sheet.net(960, 1385, "U9")
    sheet.text(20, 1470, "Over-current: 18 A in either shunt; over-temperature: driver's NTC at 85 C", kind="head")
    for y, shunt, resistor, capacitor, part, out in (
        (1510, "shunt_a", "R32", "C7", "U14A", "trip_a"),
        (1600, "shunt_b", "R33", "C8", "U14B", "trip_b"),
    ):
        sheet.net(80, y, shunt, left=True)
        sheet.resistor(110, y, resistor, "1k")
        sheet.wire((140, y), (260, y))
        sheet.dot(170, y)
        sheet.capacitor(170, y + 30, capacitor, "330 pF", upright=True)
        sheet.ground(170, y + 60)
        sheet.amplifier(300, y + 15, part, "TLV3502")
        sheet.net(260, y + 30, "limit", left=True)
        sheet.net(340, y + 15, out)
    sheet.resistor(400, 1530, "R34", "17.4k", upright=True)
    sheet.resistor(400, 1590, "R35", "1k", upright=True)
    sheet.net(400, 1497, "3.3 V")
    sheet.net(405, 1560, "limit")
    sheet.ground(400, 1620)
    sheet.amplifier(620, 1530, "U7B", "TLV3502")
    sheet.net(480, 1497, "3.3 V")
    sheet.resistor(480, 1530, "R38", "18.2k", upright=True)
    sheet.resistor(480, 1590, "R39", "2.0k", upright=True)
    sheet.dot(480, 1560)
    sheet.wire((480, 1560), (545, 1560), (545, 1515), (580, 1515))
    sheet.ground(480, 1620)
    sheet.wire((580, 1545), (572, 1545), (572, 1575))
    sheet.net(568, 1583, "PC2")
    sheet.net(660, 1530, "hot")
    sheet.box(720, 1570, "U15", "74LVC1G74: latch", (120, 60))
    sheet.net(720, 1590, "set: trip_a | trip_b | hot", left=True)
    sheet.net(720, 1615, "clear: !enable", left=True)
    sheet.wire((840, 1600), (886, 1600))
    sheet.net(842, 1592, "latch")
    sheet.transistor(920, 1600, "Q6", "2N7002")
    sheet.ground(920, 1630)
    sheet.wire((920, 1570), (920, 1560), (980, 1560))
    sheet.dot(920, 1560)
    sheet.resistor(920, 1530, "R36", "4.7k", upright=True)
    sheet.net(920, 1497, "3.3 V")
    sheet.net(980, 1560, "fault (PB12, PA6)")


def sensor(sheet: Sheet) -> None:
    """Draw one axis of the sensor."""
    sheet.text(20, 30, "Sensor: one axis of three", kind="head")
    sheet.box(30, 70, "B1", "HMC1001 (z); HMC1002 (x, y)", (190, 90))
    sheet.net(30, 90, "8 V", left=True)
    sheet.ground(60, 160)
    sheet.text(36, 150, "bridge of 850 Ohm")
    sheet.amplifier(340, 115, "U21", "AD8421")
    sheet.wire((220, 100), (300, 100))
    sheet.wire((220, 130), (300, 130))
    sheet.text(250, 95, "bridge_p", kind="net")
    sheet.text(250, 145, "bridge_n", kind="net")
    sheet.resistor(340, 60, "R51", "316")
    sheet.text(380, 56, "between the gain pins")
    sheet.net(330, 165, "ref: ref165")
    sheet.resistor(430, 115, "R52", "1.6k")
    sheet.wire((380, 115), (400, 115))
    sheet.wire((460, 115), (640, 115))
    sheet.capacitor(490, 145, "C51", "1 nF", upright=True)
    sheet.ground(490, 175)
    sheet.dot(490, 115)
    sheet.diode(560, 85, "D51", "BAT54", turn=-90)
    sheet.net(560, 52, "3.3 V")
    sheet.dot(560, 115)
    sheet.diode(600, 145, "D52", "BAT54", turn=-90)
    sheet.ground(600, 175)
    sheet.dot(600, 115)
    sheet.net(640, 115, "PA1, PA2, PA3")


def board(sheet: Sheet) -> None:
    """Draw pull-downs, thermometers, the divider of the supply, and CAN."""
    sheet.text(20, 230, "Board: pulls, thermometers, supply, CAN", kind="head")
    for k, (part, value, net) in enumerate(
        (
            ("R61", "10k", "PB13"),
            ("R62", "10k", "PB14"),
            ("R63", "10k", "PB0"),
            ("R64", "10k", "PB1"),
            ("R65", "10k", "PB15 (enable)"),
            ("R66", "10k", "PA7 (sync out)"),
        )
    ):
        x = 50 + 120 * k
        sheet.net(x, 258, net)
        sheet.resistor(x, 295, part, value, upright=True)
        sheet.ground(x, 325)
    for k, (part, thermistor, net) in enumerate((("R67", "RT1", "PC1"), ("R68", "RT2", "PC3"), ("R69", "RT3", "PC2"))):
        x = 50 + 140 * k
        sheet.net(x, 378, "3.3 V")
        sheet.resistor(x, 410, part, "10k", upright=True)
        sheet.resistor(x, 480, thermistor, "NTC 10k, B 3950", upright=True)
        sheet.wire((x, 440), (x, 450))
        sheet.dot(x, 445)
        sheet.net(x + 4, 446, net)
        sheet.ground(x, 510)
    sheet.net(490, 378, "hv (120 V)")
    sheet.resistor(490, 410, "R70", "475k", upright=True)
    sheet.resistor(490, 480, "R71", "10k", upright=True)
    sheet.wire((490, 440), (490, 450))
    sheet.dot(490, 445)
    sheet.net(494, 434, "PC0")
    sheet.ground(490, 510)
    sheet.capacitor(590, 480, "C61", "10 nF", upright=True)
    sheet.wire((490, 445), (590, 445), (590, 450))
    sheet.ground(590, 510)
    sheet.box(680, 400, "U61", "SN65HVD230", (140, 80))
    sheet.text(672, 429, "PB9", kind="net", anchor="end")
    sheet.text(672, 459, "PB8", kind="net", anchor="end")
    sheet.wire((820, 425), (880, 425))
    sheet.wire((820, 455), (880, 455))
    sheet.net(880, 425, "CANH")
    sheet.net(880, 455, "CANL")
    sheet.text(700, 470, "Rs to ground")
    sheet.resistor(850, 510, "R72", "120")
    sheet.text(740, 548, "R72 at both ends of the bus")


def main() -> int:
    """Draw both sheets."""
    driver = Sheet(1120, 1680)
    for part in (power, sense, target, error, logic):
        part(driver)
    front = Sheet(960, 560)
    sensor(front)
    board(front)
    for name, sheet in (("driver", driver), ("sensor", front)):
        (FOLDER / f"{name}.svg").write_text(sheet.svg(), encoding="utf-8")
        print(f"wrote docs/hardware/{name}.svg")
    return 0


if __name__ == "__main__":
    sys.exit(main())
