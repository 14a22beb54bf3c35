"""``goldfield flash --probe`` writes what ``make flash`` writes: a program in place of pyOCD keeps what it is told."""

from __future__ import annotations

import json
import sys

import pytest

from goldfield.cli import main
from goldfield.update import by_probe
from goldfield_protocol.image import KEY_PLACE, SLOTS, key_place, parse
from hil_sim.clib import ROOT
from tests.firmware.boards.stm32f405.boot_flash import slot_bytes
from tests.firmware.boards.stm32f405.test_flash_parameters import CHIP, ONE_PROBE, OPTCR, PYOCD, probes

A, B = ROOT / "build/firmware/sensor.elf", ROOT / "build/firmware/slot_b/sensor.elf"
BOOT = ROOT / "build/boot/boot.bin"
PUBLIC = "0123456789abcdef" * 4


@pytest.fixture
def flash(tmp_path, monkeypatch, capsys):
    """Run the command with the files that were built, and return exit code, stdout, stderr and what was written."""
    pyocd, key, path = (tmp_path / name for name in ("pyocd", "site.key", "new.gfi"))
    pyocd.write_text(PYOCD.format(python=sys.executable, here=tmp_path, optcr=OPTCR))
    pyocd.chmod(0o755)
    monkeypatch.setattr(by_probe, "pyocd", lambda: str(pyocd))
    main(["keys", "make", str(key)])

    def run(*words, elfs=(A, B), listed=ONE_PROBE, **state):
        (tmp_path / "probes.json").write_text(listed)
        usual = {"words": CHIP, "dead": False, "keeps_options": True, "wrong_byte": None, "written": []}
        (tmp_path / "chip.json").write_text(json.dumps(usual | state))
        main(["image", "sign", *map(str, elfs), "--key", str(key), "--out", str(path), "--force"])
        capsys.readouterr()
        code = main(["flash", str(path), "--probe", *words])
        told = capsys.readouterr()
        return code, told.out, told.err, {p.name: p.read_bytes() for p in tmp_path.glob("at_*")}

    return run


def test_boot_loader_key_and_image_are_written_and_compared(flash):
    code, out, _, written = flash("--public", PUBLIC, "--boot", str(BOOT))
    assert code == 0
    assert "debug probe: STM32 STLink 066DFF01" in out
    assert "verified: " in out
    assert "brown-out reset set to level 3" in out
    assert out.endswith("programmed: sensor 0.1.0 for slot A\n")
    built = slot_bytes(A, 0)
    image = written[f"at_{SLOTS[0]:08x}"]
    assert parse(image) == parse(built)
    assert image[:64] == built[:64]  # It counts as confirmed.
    first = written["at_08000000"]
    assert first.startswith(BOOT.read_bytes())
    assert first[KEY_PLACE - 0x08000000 :] == key_place(bytes.fromhex(PUBLIC))
    assert written[f"at_{SLOTS[1]:08x}"] == b"\xff" * 512


def test_without_a_public_key_it_is_told(flash):
    code, _, told, written = flash("--boot", str(BOOT))
    assert code == 0
    assert "no --public is given: this board will take no image over its links" in told
    assert written["at_08000000"] == BOOT.read_bytes()


@pytest.mark.parametrize(
    ("words", "options", "code", "sentence"),
    [
        (["--all"], {}, 2, "--probe programs the one board that it is at: leave --all out"),
        (["--port", "/dev/x"], {}, 2, "leave --port out"),
        (["--role", "beacon"], {}, 2, "the file has no beacon for slot A"),
        ([], {"elfs": [B]}, 2, "the file has no image for slot A, which a probe writes"),
        (
            [],
            {"elfs": [A, A.with_name("beacon.elf")]},
            2,
            "images of several roles, sensor, beacon: say which with --role",
        ),
        (["--public", "ab"], {}, 2, "'ab' is no public key"),
        (["--boot", "gone.bin"], {}, 2, "gone.bin: there is no such boot loader"),
        ([], {"listed": probes()}, 2, "no debug probe was found"),
        (
            [],
            {"listed": probes("066DFF01", "0672AA")},
            2,
            "several debug probes are connected: give one of --probe 066",
        ),
        ([], {"dead": True}, 3, "pyOCD cannot reach the chip"),
        ([], {"keeps_options": False}, 3, "the chip did not take the brown-out level"),
    ],
)
def test_what_does_not_work_is_told(flash, words, options, code, sentence):
    boot = [] if "--boot" in words else ["--boot", str(BOOT)]
    got, _, told, _ = flash(*words, *boot, **options)
    assert got == code
    assert sentence in told


def test_what_only_a_probe_writes_needs_one(tmp_path, capsys):
    assert main(["flash", str(tmp_path / "x"), "9", "--public", PUBLIC, "--port", "/dev/x"]) == 2
    assert "--public and --boot are written by a probe alone" in capsys.readouterr().err
