"""A campaign with a folder that a recorder writes to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from written_drops import CAMPAIGN, drop, write

from bayestissue.studies.bench.campaign_file import read_campaign
from bayestissue.studies.bench.drops import Drops
from bayestissue.studies.bench.order import order_of
from bayestissue.studies.bench.watching import Watch


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    (tmp_path / "recorded").mkdir()
    return tmp_path / "recorded"


@pytest.fixture
def begin(recorded: Path) -> Callable[[], Watch]:
    """A watch of it, or the next one after an earlier was killed; ready, its lines in ``said``."""

    def begun() -> Watch:
        campaign = read_campaign(recorded.parent / "campaign.toml")
        drops = Drops(recorded.parent / "set", campaign)
        watch = Watch(recorded, campaign, drops, order_of(campaign, None), lambda _: None)
        watch.study.update(drops.used, wait=True)
        return watch

    return begun


@pytest.fixture
def watched(begin: Callable[[], Watch], recorded: Path) -> Callable[[Sequence[str]], Watch]:
    """A watch that has taken these drops."""

    def taken(names: Sequence[str]) -> Watch:
        for name in names:
            write(recorded, name, drop(name))
        watch = begin()
        watch.catch_up(0)
        return watch

    return taken
