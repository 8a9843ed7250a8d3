from __future__ import annotations

import pytest
from pydantic import ValidationError

from bayestissue.errors import InputError
from bayestissue.resources import shared
from bayestissue.signal import SignalOptions, alternatives, read_signal_options


def test_the_model_files_say_what_they_are_for():
    assert read_signal_options(shared("models", "exact.toml")) == SignalOptions()
    dds = read_signal_options(shared("models", "dds.toml"))
    assert (dds.window, dds.integration, dds.equilibrium) == ("peak", "trapezoidal", "sample-mean")


def test_a_model_file_without_the_table_means_the_defaults(tmp_path):
    path = tmp_path / "model.toml"
    path.write_text('name = "mine"\n')
    assert read_signal_options(path) == SignalOptions()


def test_everything_wrong_is_named_at_once(tmp_path):
    path = tmp_path / "model.toml"
    path.write_text('[signal]\nwindow = "pk"\nfiltre = 60\nthreshold = 4\nfilter = 70\n')
    with pytest.raises(InputError) as refusal:
        read_signal_options(path)
    problems = {problem.column: problem for problem in refusal.value.problems}
    assert set(problems) == {"signal.window", "signal.filtre", "signal.threshold", "signal.filter"}
    assert "'peak' or 'rebound'" in problems["signal.window"].expected
    assert "filter" in problems["signal.filtre"].expected
    assert "180" in problems["signal.filter"].expected


def test_a_table_of_the_wrong_kind_is_refused(tmp_path):
    path = tmp_path / "model.toml"
    path.write_text("signal = 3\n")
    with pytest.raises(InputError, match=r"\[signal\]"):
        read_signal_options(path)


@pytest.mark.parametrize("window", [0.0, 1.5, "half"])
def test_windows_outside_the_impact_are_refused(window):
    with pytest.raises(ValidationError):
        SignalOptions(window=window)


@pytest.mark.parametrize("choice", ["contact", "filter", "window", "integration", "equilibrium"])
def test_a_choice_is_varied_alone_over_valid_values(choice):
    base = SignalOptions(threshold=0.1)
    varied = alternatives(choice, base)
    assert len({getattr(options, choice) for options in varied}) == len(varied) > 1
    for options in varied:
        assert SignalOptions(**options.model_dump()) == options
        assert options.model_copy(update={choice: getattr(base, choice)}) == base


def test_an_unknown_choice_is_refused():
    with pytest.raises(InputError, match="one of contact, filter"):
        alternatives("colour", SignalOptions())
