"""The formats that recorders write. A new one is a module with a record `Format`, and two lines here."""

from bayestissue.dataset.formats import (
    biopac,
    c3d,
    hdf5,
    labview,
    mat,
)
from bayestissue.dataset.formats.channel import (
    Channel,
    Contents,
    Format,
    UnfitError,
    even_clock,
    unit_in_name,
)

FORMATS: dict[str, Format] = {
    form.suffix: form
    for form in (
        *labview.FORMATS,
        mat.FORMAT,
        c3d.FORMAT,
        biopac.FORMAT,
        *hdf5.FORMATS,
    )
}

__all__ = ["FORMATS", "Channel", "Contents", "Format", "UnfitError", "even_clock", "unit_in_name"]
