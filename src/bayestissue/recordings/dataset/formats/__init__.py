"""The formats that recorders write. A new one is a module with records `Format`, and two lines here."""

from bayestissue.recordings.dataset.formats import (
    biopac,
    c3d,
    hdf5,
    labview,
    mat,
)
from bayestissue.recordings.dataset.formats.channel import Format

# In the order in which the manual shows them.
EACH = (
    *labview.FORMATS,
    *mat.FORMATS,
    *c3d.FORMATS,
    *biopac.FORMATS,
    *hdf5.FORMATS,
)
FORMATS: dict[str, Format] = {suffix: form for form in EACH for suffix in form.suffixes}
