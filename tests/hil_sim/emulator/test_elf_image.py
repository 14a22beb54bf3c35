"""An image that is read again: what it is by now, and nothing that a reader has done to what it got before."""

import shutil
from pathlib import Path

import pytest

from hil_sim import clib
from hil_sim.emulator import BadImageError
from hil_sim.emulator.elf_image import read_image


def test_a_file_that_has_become_another_is_read_anew(tmp_path: Path) -> None:
    path = tmp_path / "image.elf"
    images = [clib.built(f"firmware/{role}.elf") for role in ("beacon", "sensor")]
    for image in [*images, images[0]]:
        shutil.copy(image, path)
        assert read_image(path) == read_image(image)
    assert read_image(images[0]) != read_image(images[1])
    path.write_bytes(b"\x7fELF")
    with pytest.raises(BadImageError, match=r"image\.elf is not an ELF image"):
        read_image(path)


def test_who_changes_what_was_read_changes_nothing_for_others() -> None:
    image = clib.built("firmware/beacon.elf")
    segments, symbols = read_image(image)
    expected = list(segments), dict(symbols)
    segments.clear()
    symbols.clear()
    assert read_image(image) == expected
