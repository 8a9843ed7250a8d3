"""The formats that recorders write. A new one is a module that reads it, two lines here and one in the TOML.

``formats.toml`` says what each is called, how its files' names end, and what its times and values are.
"""

from bayestissue.base.declarations import declared
from bayestissue.recordings.dataset.formats import (
    biopac,
    c3d,
    hdf5,
    labview,
    mat,
)
from bayestissue.recordings.dataset.formats.channel import Format

READERS = {
    "lvm": labview.read_lvm,
    "tdms": labview.read_tdms,
    "mat": mat.read,
    "c3d": c3d.read,
    "acq": biopac.read,
    "hdf5": hdf5.read,
}
EACH = [Format(read=READERS[key], **entry) for key, entry in declared(__package__, "formats.toml").items()]
FORMATS: dict[str, Format] = {suffix: form for form in EACH for suffix in form.suffixes}
