"""Files that people write, TOML and CSV, read so that each complaint names file, line and key."""
