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
        ("an impact on a person, 3 impacts", "a drop on a pad, 3 drops"),
        ("An impact", "A drop"),
        ("persons’ effects", "pads’ effects"),
        # Names of files, columns, models and options are not nouns of a sentence.
        ("impacts.csv, levels.csv, K[impact=7], `impact`, sd_impact_K", None),
        ("the impactor", None),
    ],
)
def test_the_datasets_nouns_stand_in_sentences(said: str, becomes: str | None) -> None:
    assert PADS(said) == (said if becomes is None else becomes)


def test_articles_and_plurals_follow_the_noun() -> None:
    athletes = Words({"subject": "athlete", "subjects": "men and women"})
    assert athletes("a person, and people") == "an athlete, and men and women"
    assert athletes("A person") == "An athlete"


def test_the_users_own_names_stay() -> None:
    words = Words({"subject": "pad"}, ("first person", "people"))
    assert words("first person of the people, a person") == "first person of the people, a pad"


def test_only_the_prose_of_a_page_changes() -> None:
    page = (
        '<script>let person = 1;</script><a id="people" title="a person" href="levels.csv">people</a>'
        "<code>person</code><style>.person {}</style> of one person"
    )
    assert PADS.page(page) == (
        '<script>let person = 1;</script><a id="people" title="a pad" href="levels.csv">pads</a>'
        "<code>person</code><style>.person {}</style> of one pad"
    )
    assert PLAIN.page(page) == page


def test_a_chart_keeps_its_columns() -> None:
    chart = {"encoding": {"x": {"field": "person", "title": "person"}}, "datasets": {"a": [{"person": "s1"}]}}
    assert PADS.chart(chart) == {
        "encoding": {"x": {"field": "person", "title": "pad"}},
        "datasets": {"a": [{"person": "s1"}]},
    }


def test_nouns_and_names_on_a_page_are_escaped() -> None:
    words = Words({"impact": '<b a="'}, ("impact & person",))
    assert words.page("one impact, impact &amp; person") == "one &lt;b a=&#34;, impact &amp; person"
    assert words.page('<a title="an impact">') == '<a title="a &lt;b a=&#34;">'
    assert words("one impact") == 'one <b a="'
