"""Keys: one spelling for one content."""

from __future__ import annotations

import math
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jointplay.catalogue.errors import KeyContentError
from jointplay.catalogue.plans.entry import canonical_json, content_digest, entry_key, seed_from

plain = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


def test_spelling() -> None:
    value = {"b": [1, 2.0, True, None], "a": {"µ": 1e-05, "z": 0.1}}
    assert canonical_json(value) == '{"a":{"z":0.1,"\\u00b5":1e-05},"b":[1,2.0,true,null]}'


def test_spelling_of_numpy_values_is_that_of_plain_ones() -> None:
    array = {"a": np.float64(0.1), "b": np.array([1, 2]), "c": np.str_("x"), "d": (np.bool_(True),)}
    assert canonical_json(array) == canonical_json({"a": 0.1, "b": [1, 2], "c": "x", "d": [True]})


@given(st.dictionaries(st.text(), plain, min_size=2))
def test_order_of_keys_does_not_matter(content: dict[str, object]) -> None:
    turned = dict(reversed(content.items()))
    assert canonical_json(turned) == canonical_json(content)


@given(plain)
def test_reads_back(value: object) -> None:
    import json

    assert json.loads(canonical_json(value)) == value


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, np.float32("nan")])
def test_numbers_that_are_not_finite_are_refused_with_their_place(value: float) -> None:
    with pytest.raises(KeyContentError, match=r"^parameters\.drive\.speed: .*must be a finite number$"):
        canonical_json({"parameters": {"drive": {"speed": value}}})


@pytest.mark.parametrize("value", [{1: 2}, {"a": object()}, {"a": b"bytes"}, {"a": {1, 2}}])
def test_what_is_not_data_is_refused(value: object) -> None:
    with pytest.raises(KeyContentError):
        canonical_json(value)


BASE = {
    "machine_key": "ab" * 32,
    "clearances": {"A": 2e-4, "F": 5e-5},
    "parameters": {"drive.speed": 12.5, "contact.friction": 0.05},
    "settings": {"accuracy": "draft", "sample_rate": 10000.0},
    "numbers_version": 1,
}


def test_key_is_pinned() -> None:
    """A key that changes without a change of content orphans every catalogue there is."""
    assert entry_key(**BASE) == "36967e734ac1bc9d3ce94c22303031d8affd5f0998f3a21a7e5ac0035427cc22"  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "change",
    [
        {"machine_key": "ac" * 32},
        {"clearances": {"A": math.nextafter(2e-4, 1), "F": 5e-5}},
        {"clearances": {"A": 2e-4, "E": 5e-5}},
        {"clearances": {}},
        {"parameters": {"drive.speed": 12.5}},
        {"parameters": {"drive.speed": math.nextafter(12.5, 0), "contact.friction": 0.05}},
        {"settings": {"accuracy": "standard", "sample_rate": 10000.0}},
        {"numbers_version": 2},
        {"variant": {"law": "hertz"}},
    ],
)
def test_every_part_changes_the_key(change: dict[str, object]) -> None:
    assert entry_key(**{**BASE, **change}) != entry_key(**BASE)  # type: ignore[arg-type]


def test_kinds_of_numbers_do_not_change_the_key() -> None:
    as_numpy = {**BASE, "parameters": {"contact.friction": np.float64(0.05), "drive.speed": np.float64(12.5)}}
    whole = {**BASE, "parameters": {"drive.speed": 12.0, "contact.friction": 0.0}}
    as_int = {**BASE, "parameters": {"drive.speed": 12, "contact.friction": -0.0}}
    assert entry_key(**as_numpy) == entry_key(**BASE)  # type: ignore[arg-type]
    assert entry_key(**as_int) == entry_key(**whole)  # type: ignore[arg-type]


def test_the_machine_as_filed_is_no_variant() -> None:
    assert entry_key(**BASE, variant={}) == entry_key(**BASE)  # type: ignore[arg-type]


def test_keys_and_seeds_are_the_same_in_every_process() -> None:
    """Not so with Python's own hash, which is salted."""
    printed = "print(content_digest({'a': 0.1}), seed_from(1, 'A+F', (1e-5, 2e-5), 1.0))"
    code = f"from jointplay.catalogue.plans.entry import *; {printed}"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env={**os.environ})
    assert run.stdout.split() == [content_digest({"a": 0.1}), str(seed_from(1, "A+F", (1e-5, 2e-5), 1.0))]
