from __future__ import annotations

import pytest
from dense_normal import Dense


@pytest.fixture(
    params=[(1, 0.0), (2, 0.0), (2, 0.3)],
    ids=["one impact a cell", "two impacts a cell", "an error of mass that is a person's"],
)
def dense(request: pytest.FixtureRequest) -> Dense:
    repeats, shared = request.param
    return Dense(repeats, shared=shared)
