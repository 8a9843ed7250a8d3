"""Result folders: whole or not there, never at the cost of anything but earlier results."""

from bayestissue.results.files import put, scratch, sync_folder, whole_file, write_json, write_tree
from bayestissue.results.mark import damaged, require_file, require_free, require_place
from bayestissue.results.place import Place, claim, claim_if, locked_folder, locked_in_place
from bayestissue.results.tables import read_table, read_tables, write_table

__all__ = [
    "Place",
    "claim",
    "claim_if",
    "damaged",
    "locked_folder",
    "locked_in_place",
    "put",
    "read_table",
    "read_tables",
    "require_file",
    "require_free",
    "require_place",
    "scratch",
    "sync_folder",
    "whole_file",
    "write_json",
    "write_table",
    "write_tree",
]
