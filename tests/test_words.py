"""What a dataset calls its people, conditions and impacts."""

from __future__ import annotations

import pytest

from bayestissue.base.words import PLAIN, Words

PADS = Words({"subject": "pad", "impact": "drop"})


@pytest.mark.parametrize(
    ("said", "becomes"),
    [
        ("K of a typical person", "K of a typical pad"),
        ("People differ; a person's impacts", "Pads differ; a pad's drops"),
        ("An impact on a person, 3 impacts", "A drop on a pad, 3 drops"),
        # Names of files, columns, models and options are not nouns of a sentence.
        ("impacts.csv, levels.csv, K[impact=7], `impact`, sd_impact_K", None),
        ("the impactor", None),
    ],
)
def test_the_datasets_nouns_stand_in_sentences(said: str, becomes: str | None) -> None:
    assert PADS(said) == (said if becomes is None else becomes)


def test_articles_and_plurals_follow_the_noun() -> None:
    athletes = Words({"subject": "athlete", "subjects": "men and women"})
    assert athletes("A person, and people") == "An athlete, and men and women"
    # The users' own names stay.
    words = Words({"subject": "pad"}, ("first person", "people"))
    assert words("first person of the people, a person") == "first person of the people, a pad"


def test_only_the_prose_of_a_page_changes() -> None:
    said = '<script>let person = 1;</script><a id="people" title="a {}">{}</a><code>person</code>'
    page = said.format("person", "people")
    assert PADS.page(page) == said.format("pad", "pads")
    assert PLAIN.page(page) == page


def test_a_chart_keeps_its_columns() -> None:
    def chart(title: str) -> dict[str, object]:
        return {"x": {"field": "person", "title": title}, "datasets": {"a": [{"person": "s1"}]}}

    assert PADS.chart(chart("person")) == chart("pad")


def test_nouns_and_names_on_a_page_are_escaped() -> None:
    words = Words({"impact": '<b a="'}, ("impact & person",))
    assert words.page("one impact, impact &amp; person") == "one &lt;b a=&#34;, impact &amp; person"
    assert words.page('<a title="an impact">') == '<a title="a &lt;b a=&#34;">'
    assert words("one impact") == 'one <b a="'
