from __future__ import annotations

import pytest
from pydantic import ValidationError

from bayestissue.base.errors import InputError
from bayestissue.base.resources import shared
from bayestissue.recordings.signal import SignalOptions, read_signal_options


def test_the_commented_model_file_has_the_defaults():
    assert read_signal_options(shared("models", "impact.toml")) == SignalOptions()


def test_a_table_of_the_wrong_kind_is_refused(tmp_path):
    path = tmp_path / "model.toml"
    path.write_text("signal = 3\n")
    with pytest.raises(InputError, match=r"\[signal\]"):
        read_signal_options(path)


@pytest.mark.parametrize("window", [0.0, 1.5, "half"])
def test_windows_outside_the_impact_are_refused(window):
    with pytest.raises(ValidationError):
        SignalOptions(window=window)
