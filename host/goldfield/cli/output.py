"""What the subcommands print: the JSON lines of `goldfield.view.records`."""

from goldfield.view.records import elements, json_line, number, pose_record, whole_array

__all__ = ["elements", "json_line", "number", "pose_record", "whole_array"]
