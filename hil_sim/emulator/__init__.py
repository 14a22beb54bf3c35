"""An STM32F405 board that runs the image to be flashed: Unicorn and register-level peripheral models, in C."""

from hil_sim.emulator.emulator import Configuration, Emulator, Probe, Statistics
from hil_sim.emulator.kept_flash import BadImageError

__all__ = ["BadImageError", "Configuration", "Emulator", "Probe", "Statistics"]
