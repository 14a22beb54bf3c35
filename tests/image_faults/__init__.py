"""Each instruction of the code that protects skipped once, and registers flipped, on the flashable images."""
