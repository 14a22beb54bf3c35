"""Recordings of runs: written beside the poses, read again, compared, exported and drawn.

`formats` chooses the writer by a file's name, `mcap_recording` writes what a run makes on the topics of
`goldfield.foxglove`, and `runs` reads the poses and fields of a file again. The messages of a recording, in any
format, are read by `goldfield.link.log_formats`.
"""
