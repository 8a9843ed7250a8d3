from __future__ import annotations

import json
import re
from html import unescape

import pytest
import xarray as xr

from bayestissue.base.errors import InputError
from bayestissue.inference.checking.findings import Finding, headline
from bayestissue.inference.checking.model_form import stated
from bayestissue.reports.pages import write_report
from bayestissue.reports.pages.fit.fit_page import page_of as fit_page_of
from bayestissue.reports.pages.run_folder import read_about
from make_fit_run import changed, make_fit_run, read_fit_run
from page_reader import Reader

pytestmark = pytest.mark.usefixtures("read_once")


def page_of(folder):
    return write_report(folder).read_text(encoding="utf-8")


def first_screen(html):
    return html[html.index('class="first"') : html.index("<nav")]


def sentences(html, quantity):
    """Those of the pictures of K (or C) on the first screen."""
    captions = rf'<figure class="of-{quantity}"><figcaption>(.*?)</figcaption>'
    return [plain(text).strip() for text in re.findall(captions, html, re.DOTALL)]


def plain(html):
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", "", html)).replace("\N{NO-BREAK SPACE}", " ")
    return unescape(text)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return make_fit_run(tmp_path_factory.mktemp("fit") / "run")


@pytest.fixture(scope="module")
def html(folder):
    return page_of(folder)


@pytest.mark.slow
def test_the_page_is_whole_and_asks_nothing_of_the_network(html):
    page = Reader()
    page.feed(html)
    assert page.open == []
    assert page.unnamed == 0
    assert len(page.ids) == len(set(page.ids))
    assert {link[1:] for link in page.links} <= set(page.ids)
    assert all(source.startswith("data:") for source in page.sources)


def test_the_first_screen_has_two_pictures_of_k_and_of_c_each_with_its_sentence(html):
    first = first_screen(html)
    for question in ("What are K and C?", "Is the dependence on mass real?"):
        assert question in first
    of_whom, of_mass = sentences(html, "K")
    who = (
        r"People differ by ±\d+\s% \(sd\); a new person’s K is \d+ to \d+ N/m nine times in ten \(shaded\)\."
    )
    assert re.fullmatch(who, of_whom)
    assert re.match(r"K is almost certainly independent of the mass: exponent −?0\.0\d+ \(−", of_mass)
    assert [len(sentences(html, q)) for q in "KC"] == [2, 2]
    # The switch has both values, whichever is shown.
    for name, unit in (("stiffness K", "N/m"), ("damping C", "N s/m")):
        assert re.search(
            rf"> {name} <b>[\d.]+</b> {unit} <span class=\"interval\">[\d.]+ to [\d.]+</span>", first
        )
    assert "Diagnostics passed." in first
    # One click below.
    assert re.search(r"90\s% intervals that hold the true value ?\d+ of 12 ?\d+ of 12", plain(first))


def test_a_trend_that_only_the_thesis_method_shows_is_called_its_making(html):
    # The made-up estimates hold the same people at every mass, so their slopes are 0 and 1/2 exactly.
    assert "; by the thesis’s method 0.0" in sentences(html, "K")[1]
    assert "; the thesis’s method makes it 0.50" in sentences(html, "C")[1]
    folded = plain(html[html.index('<section id="agreement"') : html.index('<section id="chain"')])
    assert "The trend of C over the mass is made by the method." in folded


@pytest.mark.parametrize(
    "made",
    [
        {},
        {"exponent": 1.0},
        {"exponent": 0.5},
        {"exponent": None},
        {"mass_varies": False, "exponent": None},
        {"two_sides": True},
        {"own_depth": 0.3},
        {"discrepancy": True, "likelihood": "impact"},
    ],
    ids=str,
)
def test_sentences_of_the_first_screen_have_25_words_and_captions_40(made, tmp_path):
    html = page_of(make_fit_run(tmp_path / "run", **made))
    for q in "KC":
        assert sentences(html, q)
        for sentence in sentences(html, q):
            assert len(sentence.split()) <= 25, sentence
    for caption in re.findall(r"<figcaption>(.*?)</figcaption>", html, re.DOTALL):
        assert len(plain(caption).split()) <= 40, plain(caption)


@pytest.mark.slow
def test_where_stiffness_depends_on_depth_the_first_screen_answers_at_one_depth(tmp_path):
    html = page_of(make_fit_run(tmp_path, likelihood="impact", exponent=0.0, own_depth=0.3))
    assert "K at 12 mm is almost certainly independent of the mass: exponent " in sentences(html, "K")[1]
    text = plain(html)
    assert "neither K nor C depends on the mass in practice. Here K is force over depth at 12 mm" in text
    assert "At each impact's own greatest depth K ∝ M0." in text
    assert "The tissue's law is the same for every mass: heavier impactors go deeper" in text
    assert "mass exponent of K at each impact's greatest depth" in unescape(html)
    assert "K at the common depth" in text
    assert "exponent is that of the damping constant in the element" in text
    assert "It is assumed that the damper is the same at all depths" not in text
    assert "K_common_depth is the force over the depth at 12 mm and at rest" in text


def test_the_same_run_gives_the_same_page(folder, html):
    assert page_of(folder) == html


def test_the_page_tells_chain_scores_priors_limits_and_provenance(html):
    text = plain(html)
    for words in (
        "mass 0.2 % and velocity at contact 0.005 m/s",
        "leave one trial out",
        "sd_trial_K (potential prior-data conflict)",
        "models/impact.toml",
        "θ₁ follows from K, C and the sampling interval",
        "1 impact was left out",
        "0123456789abcdef",
    ):
        assert words in text
    assert "atanh_theta1" not in text


def test_it_tells_what_makes_the_intervals(folder, html):
    text = plain(html)
    text = text[text.index("What makes the intervals Of the 90 %") :]
    for words in (
        "of a recorded impact: of K’s variance noise of the recorder 50 %, velocity at contact and gain 30 % "
        "and scatter between impacts 15 %",
        "of a new person: of K’s variance people 70 % and conditions 20 %",
        "The element is taken as true",
        "The window is taken as given.",
        "differs most for K of new person (2 times) and C of new person (2 times)",
    ):
        assert words in text
    table = html[html.index('id="sources"') :]
    table = plain(table[table.index("<tbody") : table.index("</tbody")])
    # Half a 90 % interval of a part is 1.645 times its standard deviation: here 0.01 times 0.5^1/2.
    assert "noise of the recorder50 % (±1.2 %)" in table
    assert "all together±1.7 %" in table
    assert table.count("taken as true") == 6


@pytest.mark.slow
def test_failed_diagnostics_are_loud_on_the_first_screen_of_any_likelihood(tmp_path):
    html = page_of(make_fit_run(tmp_path, passed=False, likelihood="impact", coloured=True))
    assert "DIAGNOSTICS FAILED" in first_screen(html)
    assert 'class="verdict failed"' in first_screen(html)
    assert "Draw longer chains." in html
    # The route of the draws stands with the sampler's diagnostics.
    assert "Sampled by the exact path, since." in plain(html)
    assert "recorded noise is not what this model assumes" in plain(first_screen(html))
    assert "accelerometer with white noise" in plain(html)
    assert "models/impact.toml" not in html


@pytest.mark.slow
def test_measured_data_without_a_mass_exponent_get_a_page(tmp_path):
    html = page_of(make_fit_run(tmp_path, truth=False, exponent=None))
    text = plain(html)
    assert sentences(html, "K")[1].startswith("This model has no mass exponent of K; by the thesis’s method ")
    assert "no mass exponent" in text
    assert "Simulated" not in text
    assert "made by the method" not in text
    assert "makes it" not in text


@pytest.mark.slow
def test_recorded_displacement_of_one_mass_gets_a_page(tmp_path):
    html = page_of(
        make_fit_run(tmp_path, quantity="displacement", truth=False, exponent=None, mass_varies=False)
    )
    assert "Measured displacement of an impact" in html
    assert "Measured less predicted:" not in plain(html)
    assert "One mass only" in plain(html)
    assert "the thesis’s method" not in plain(first_screen(html))
    assert "How do impacts differ?" in first_screen(html)
    assert "is known to ±" in sentences(html, "K")[1]


def test_everything_that_lacks_is_named_at_once(tmp_path):
    folder = make_fit_run(tmp_path)
    (folder / "summary.csv").unlink()
    (folder / "estimates_dds.csv").unlink()
    with pytest.raises(InputError) as raised:
        write_report(folder)
    assert [name in str(raised.value) for name in ("summary.csv", "estimates_dds.csv")] == [True, True]
    assert not (folder / "report.html").exists()


@pytest.mark.slow
def test_damaged_files_are_named_with_what_is_wrong_in_them(tmp_path):
    folder = make_fit_run(tmp_path)
    with xr.open_datatree(folder / "posterior.nc", engine="h5netcdf") as tree:
        tree.load()
    tree["posterior"] = xr.DataTree(tree["posterior"].to_dataset().drop_vars("K_new"))
    tree.to_netcdf(folder / "posterior.nc", engine="h5netcdf")
    (folder / "sensitivity.csv").write_text("variable,diagnosis,prior\n", encoding="utf-8")
    (folder / "diagnostics.json").write_text("{}", encoding="utf-8")
    with pytest.raises(InputError) as raised:
        write_report(folder)
    named = {(problem.file.rsplit("/", 1)[1], problem.column) for problem in raised.value.problems}
    assert named == {("posterior.nc", None), ("sensitivity.csv", "likelihood"), ("diagnostics.json", None)}


def test_a_posterior_file_that_is_none_is_named(tmp_path):
    folder = make_fit_run(tmp_path)
    (folder / "posterior.nc").write_bytes(b"not a file of draws")
    with pytest.raises(InputError, match=r"posterior\.nc"):
        write_report(folder)


def test_a_warning_of_the_model_form_has_a_colour_of_its_own(tmp_path):
    folder = make_fit_run(tmp_path / "run")
    path = folder / "run.json"
    about = json.loads(path.read_text(encoding="utf-8"))
    about["verdict"]["warned"] = True
    path.write_text(json.dumps(about), encoding="utf-8")
    about["verdict"]["words"] = f"R-hat at most 1.0.{' WARNING: The zero is off.' * 20}"
    path.write_text(json.dumps(about), encoding="utf-8")
    page = page_of(folder)
    # In a short sentence; what else is to be said is folded under it.
    assert '<div class="verdict warned" role="status"><details><summary>Diagnostics passed. <' in page
    assert '<p class="verdict-words">The zero is off.</p>' in page


def test_a_clipped_recording_is_named_on_the_first_screen_of_a_sound_fit(tmp_path):
    folder = make_fit_run(tmp_path / "run")
    path = folder / "run.json"
    about = json.loads(path.read_text(encoding="utf-8"))
    about["verdict"] |= {"passed": True, "warned": False, "remarks": "1 is clipped: a1."}
    path.write_text(json.dumps(about), encoding="utf-8")
    assert "no check speaks against the model. 1 is clipped: a1." in plain(first_screen(page_of(folder)))


def with_diagnostics(folder, **entries):
    """The run with more in its diagnostics, and the headline that follows."""
    for name in ("diagnostics", "run"):
        path = folder / f"{name}.json"
        content = json.loads(path.read_text(encoding="utf-8"))
        if name == "diagnostics":
            content = diagnostics = content | entries
        else:
            content["verdict"] |= {"headline": headline(diagnostics), "warned": True}
        path.write_text(json.dumps(content), encoding="utf-8")
    return folder


def test_a_contradicted_chain_stands_on_the_first_screen(tmp_path):
    words, first = "They ask for a velocity 11 % higher.", "the traces contradict the measuring chain"
    chain = Finding("measuring-chain", False, words, first).record(impacts=[], of=12)
    html = page_of(with_diagnostics(make_fit_run(tmp_path / "run"), measuring_chain=chain))
    first = plain(first_screen(html))
    assert "The sampler passed, but the traces contradict the measuring chain." in first
    assert "Diagnostics passed." not in first
    assert "They ask for a velocity 11 % higher. A wrong mass does not show" in plain(html)


@pytest.mark.slow
def test_a_chain_that_is_as_declared_is_said_below(tmp_path):
    html = page_of(
        with_diagnostics(make_fit_run(tmp_path / "run"), measuring_chain={"passed": True, "of": 12})
    )
    assert "What the 12 traces by themselves ask of velocity, gain and offset is as large as" in plain(html)


def test_no_interval_is_printed_of_traces_that_no_element_describes(tmp_path):
    form = stated({"score": 9.0, "undescribed": True, "discrepancy": 0.3})
    html = page_of(with_diagnostics(make_fit_run(tmp_path / "run"), model_form=form))
    first = first_screen(html)
    assert "No element of this program describes these traces" in first
    assert re.search(r"<s>\d{4} N/m</s>", first)
    assert " to " not in plain(re.search(r"K <s>.*?</p>", first).group())
    assert 'class="pictures"' not in first
    # Twelve impacts, of each K and C.
    assert html.count("<td>not an interval</td>") == 24


def test_the_page_has_the_datasets_own_nouns(folder):
    run = read_fit_run(folder, read_about(folder))
    nouns = {"subject": "pad", "trial": "height", "impact": "drop"}
    page = fit_page_of(changed(run, record=run.record | {"words": nouns}))
    prose = re.sub(r"<(script|style|code|pre)\b.*?</\1>", "", page, flags=re.DOTALL)
    assert not re.search(r"\b(person|persons|people)\b(?!\.csv)", plain(prose), re.IGNORECASE)
    assert "a typical pad" in plain(prose)
    assert " drops" in plain(first_screen(page))
    # What scripts tell of an impact stands in the prose, and in no script.
    assert "far from what its pad and height let one expect" in plain(prose)
    scripts = "".join(re.findall(r"<script>.*?</script>", page, re.DOTALL))
    assert "its person" not in scripts
