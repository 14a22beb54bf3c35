"""The fault campaign: seeded faults on simulated boards, and what the host's poses make of them (README.md)."""
