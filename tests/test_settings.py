"""What is wrong with a settings file, said once."""

from __future__ import annotations

from typing import Annotated

import pytest
from pydantic import BaseModel, ConfigDict, Field

from bayestissue.base.errors import InputError
from bayestissue.base.settings import checked


class Condition(BaseModel):
    model_config = ConfigDict(extra="forbid")
    mass_kg: float


class Design(BaseModel):
    conditions: Annotated[tuple[Condition, ...], Field(min_length=1)]


def test_a_list_of_wrong_tables_is_not_also_called_empty() -> None:
    with pytest.raises(InputError) as caught:
        checked({"conditions": [{"mass_kg": 1.0, "repeats": 7}]}, Design, file="design.toml")
    assert [problem.column for problem in caught.value.problems] == ["conditions.0.repeats"]


def test_an_empty_list_is_called_so() -> None:
    with pytest.raises(InputError) as caught:
        checked({"conditions": []}, Design, file="design.toml")
    assert [problem.column for problem in caught.value.problems] == ["conditions"]
