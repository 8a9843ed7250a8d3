"""A campaign with a folder that a recorder writes to."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from written_drops import CAMPAIGN

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
