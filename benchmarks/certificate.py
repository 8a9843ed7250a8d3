"""The certificate of the example: its study drawn anew from its own posterior, and fitted each time.

    .venv/bin/python benchmarks/certificate.py

A row has a quantity, what its ranks over all refits say, and the seconds of the whole certificate.
"""

from __future__ import annotations

import time

from evidence import recorded

import bayestissue as bt
from bayestissue.base.resources import shared
from bayestissue.base.runtime import configure
from bayestissue.studies.certificate import REFITS


def main() -> None:
    configure()
    with recorded("certificate") as record:
        fit = bt.fit(shared("data", "example"))
        begin = time.monotonic()
        made = bt.certify(fit, refits=REFITS)
        seconds = round(time.monotonic() - begin)
        record.write(made.calibration.assign(certified=made.passed, seconds=seconds))


if __name__ == "__main__":
    main()
