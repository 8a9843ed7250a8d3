"""Result folders: whole or not there, never at the cost of anything but earlier results."""

from bayestissue.results.files import write_json, write_tree
from bayestissue.results.mark import damaged
from bayestissue.results.place import Place, claim, claim_if
from bayestissue.results.refusals import require_free, require_place
from bayestissue.results.staging import scratch, whole_file

__all__ = [
    "Place",
    "claim",
    "claim_if",
    "damaged",
    "require_free",
    "require_place",
    "scratch",
    "whole_file",
    "write_json",
    "write_tree",
]
