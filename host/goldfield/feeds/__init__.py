"""Feeds: live poses for other programs, each kind in a file of its own; ``docs/feeds.md`` tells what each sends."""
