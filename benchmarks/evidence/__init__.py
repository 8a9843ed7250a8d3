"""What was measured, by which script, on which version of the program, and where the figures are printed.

`registry` reads evidence.toml, `fingerprint` tells whether a part of the program has changed, `provenance` is
what a script writes beside its result, `figures` makes tables and sentences of result files, and `pages` puts
these into the README and the manual; `simulations` makes what a script simulates of the TOML file beside it.
The command is `python -m evidence`; `make evidence` calls it.
"""

from evidence.provenance import measure, recorded

__all__ = ["measure", "recorded"]
