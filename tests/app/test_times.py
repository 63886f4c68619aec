"""Moments on pages: elements that scripts show in the reader's zone, in UTC without them."""

from __future__ import annotations

from datetime import UTC, datetime

from jointplay.app.http.handlers import show_moment, show_moments

AT = datetime(2026, 3, 1, 6, 5, 59, tzinfo=UTC)


def test_a_moment_is_an_element_with_its_zone_or_without() -> None:
    said = str(show_moment(AT))
    assert said.startswith('<time datetime="2026-03-01T06:05Z">')
    assert "2026-03-01</span>" in said and "06:05 UTC</span>" in said
    assert show_moment("2026-03-01 06:05") == show_moment("2026-03-01 06:05 UTC") == show_moment(AT)
    bare = str(show_moment(AT, zone=False))
    assert " data-bare>" in bare and "UTC" not in bare


def test_moments_within_a_text_are_elements_and_the_rest_stays_text() -> None:
    said = str(show_moments("<b>, 2026-03-01 06:05 UTC, as its sender says"))
    assert said == f"&lt;b&gt;, {show_moment(AT)}, as its sender says"
    assert show_moments("2026-03-01 without a clock") == "2026-03-01 without a clock"
