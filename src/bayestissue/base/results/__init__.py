"""Result folders: whole or not there, never at the cost of anything but earlier results."""

from bayestissue.base.results.files import put, sync_folder, whole_file, write_json, write_tree
from bayestissue.base.results.manifest import (
    FileKind,
    require_as_written,
    require_file,
    require_free,
    require_place,
)
from bayestissue.base.results.output_folder import OutputFolder, claim, claim_if, locked, locked_folder
from bayestissue.base.results.tables import read_table, read_tables, write_table

__all__ = [
    "FileKind",
    "OutputFolder",
    "claim",
    "claim_if",
    "locked",
    "locked_folder",
    "put",
    "read_table",
    "read_tables",
    "require_as_written",
    "require_file",
    "require_free",
    "require_place",
    "sync_folder",
    "whole_file",
    "write_json",
    "write_table",
    "write_tree",
]
