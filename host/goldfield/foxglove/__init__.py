"""Poses, fields, site and health as messages of Foxglove's schemas: what recordings and the Foxglove feed are made of.

It needs the package ``foxglove-sdk``, as the extras ``mcap`` and ``feeds`` bring it. `topics` lists what there is,
`messages` and `scene` make the messages, `channels` logs them. Nothing here opens a file or a socket.
"""
