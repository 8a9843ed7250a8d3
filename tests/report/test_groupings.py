"""What the page of a fit says of group terms beside people and conditions."""

from __future__ import annotations

import json
import re

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from bayestissue.reports.pages.fit.fit_page import fit_page
from bayestissue.reports.pages.fit.groups import differing_words, groupings, own_slopes
from bayestissue.reports.pages.run_folder import read_json
from make_fit_run import CHAINS, DRAWS, PEOPLE, make_fit_run, read_fit_run
from tree_file import write_tree

pytestmark = [pytest.mark.usefixtures("read_once"), pytest.mark.slow]

SIDES = [f"s{person}:{side}" for person in range(PEOPLE) for side in ("left", "right")]


@pytest.fixture(scope="module", params=[0.3, 0.0], ids=["people differ", "people do not differ"])
def made(request, tmp_path_factory):
    """A run with effects of sides and people's own mass exponents, which differ or do not."""
    folder = make_fit_run(tmp_path_factory.mktemp("groups") / "run")
    rng, shape = np.random.default_rng(3), (CHAINS, DRAWS)
    path = folder / "posterior.nc"
    with xr.open_datatree(path, engine="h5netcdf") as tree:
        groups = {name: group.to_dataset().load() for name, group in tree.children.items()}
    own = groups["posterior"]["mass_exponent_K"].to_numpy()[..., None]
    own = own + request.param * np.linspace(-1, 1, PEOPLE) + 0.05 * rng.normal(size=(*shape, PEOPLE))
    effect = 0.1 * rng.normal(size=(*shape, len(SIDES)))
    groups["posterior"] = groups["posterior"].assign(
        subject_mass_exponent_K=(("chain", "draw", "subject"), own),
        sd_subject_mass_exponent_K=(("chain", "draw"), np.full(shape, 0.3)),
        subject_side_effect_K=(("chain", "draw", "subject:side"), effect),
        sd_subject_side_K=(("chain", "draw"), np.exp(-2 + 0.1 * rng.normal(size=shape))),
        K_subject_side=(("chain", "draw", "subject:side"), 2500 * np.exp(effect)),
        subject_effect_thickness_m=groups["posterior"]["subject_effect_K"],
        subject_mass_exponent_thickness_m=(("chain", "draw", "subject"), own),
        sd_subject_mass_exponent_thickness_m=(("chain", "draw"), np.full(shape, 0.3)),
        thickness_m_subject=groups["posterior"]["K_subject"].assign_attrs(unit="m"),
    )
    groups["posterior"] = groups["posterior"].assign_coords({"subject:side": SIDES})
    path.unlink()
    write_tree(groups, path)
    table = pd.read_csv(folder / "summary.csv")
    labels = [f"s{person}" for person in range(PEOPLE)]
    more = table[table["variable"] == "subject_effect_K"].assign(variable="subject_mass_exponent_K")
    sds = table[table["variable"] == "sd_subject_K"]
    more = [more.assign(label=labels), *(sds.assign(variable=f"sd_{n}_K") for n in ("subject_side",))]
    more += [sds.assign(variable=name) for name in ("sd_subject_thickness_m", "log_thickness_m_mean")]
    pd.concat([table, *more]).to_csv(folder / "summary.csv", index=False)
    about = read_json(folder / "run.json")
    about["model"]["formula"] = {"K": "1", "C": "1", "thickness_m": "(log(mass_kg)|subject)"}
    (folder / "run.json").write_text(json.dumps(about), encoding="utf-8")
    return folder, request.param


def test_groups_and_slopes_are_found_by_their_names(made) -> None:
    folder, _ = made
    run = read_fit_run(folder, read_json(folder / "run.json"))
    assert groupings(run) == ["subject", "trial", "subject:side"]
    assert [(slope.name, slope.shared) for slope in own_slopes(run)] == [
        ("subject_mass_exponent_K", "mass_exponent_K"),
        ("subject_mass_exponent_thickness_m", "mass_exponent_thickness_m"),
    ]


def test_the_page_says_whether_people_differ_in_the_dependence_on_mass(made) -> None:
    folder, differ = made
    about = read_json(folder / "run.json")
    told = differing_words(read_fit_run(folder, about))
    if differ:
        assert told.startswith(
            "People differ in it: in K 4 of 4 people are told apart from the common exponent"
        )
    else:
        assert told.startswith("People are not seen to differ in it: in K no person is told apart")
        return
    html = fit_page(folder, about)
    assert told in html[html.index('<section id="mass"') : html.index('<section id="residuals"')]
    text = re.sub(r"<[^>]+>", " ", html)
    assert "mass exponent of K of each person itself" in text
    assert "K of each of the levels of subject:side at 0.7 kg" in text
    # K and C of each person stand on the first screen.
    assert "K, C and thickness_m of each person at 0.7 kg" not in text
    assert "thickness_m of each person at 0.7 kg" in text
    assert "sd_subject_side_K" in text
    for words in ("thickness_m of each person, ranked", "log thickness_m", "sd_subject_thickness_m"):
        assert words in text, words
    assert "log_thickness_m_mean" in text
    assert re.search(r"in K \d of 4[^.;]*; in C [^.;]*; in thickness_m \d of 4", text)
