"""Colours of the page: texts can be read, and what colours tell is told to those who see fewer of them, too."""

from __future__ import annotations

import itertools
import math
import re

import numpy as np
import pytest

from jointplay.app import main

CSS = (main.STATIC / "page.css").read_text(encoding="utf-8")
TEXTS = ("text", "soft", "accent", "good", "changed", "unknown", "bad", "wear")
LINES = ("measured", "matched", "rival", "decided", *(f"joint-{look}" for look in range(6)))
TOLD_APART = {
    "verdicts": ("wear", "good", "changed", "unknown"),
    "lines": ("measured", "matched", "rival", "decided"),
    "joints": tuple(f"joint-{look}" for look in range(6)),
}
# Machado, Oliveira, Fernandes 2009: what linear RGB becomes without one kind of cones.
SEEN_BY = {
    "all": np.eye(3),
    "no green": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "no red": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
}
TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
WHITE = np.array([0.95047, 1.0, 1.08883])
APART = 18.0  # CIE 1976; some 2 can just be seen side by side


def test_own_scripts_stay_small() -> None:
    """The page is a small one: what it has of its own stays below 60 kB in all, comments and indents with it."""
    sizes = {path.name: path.stat().st_size for path in main.STATIC.glob("*.js")}
    assert len(sizes) >= 10 and sum(sizes.values()) < 60_000, sizes


def colours(scheme: str) -> dict[str, str]:
    """The variables of a scheme; the dark one changes those of the light one."""
    light, dark = re.findall(r":root \{(.*?)\}", CSS, re.DOTALL)[:2]
    found = dict(re.findall(r"--([a-z0-9-]+): (#[0-9a-f]{3,6});", light + (dark if scheme == "dark" else "")))
    return {
        name: value if len(value) == 7 else "#" + "".join(2 * digit for digit in value[1:])
        for name, value in found.items()
    }


def linear(colour: str) -> np.ndarray:
    parts = np.array([int(colour[place : place + 2], 16) for place in (1, 3, 5)]) / 255
    return np.asarray(np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4))


def contrast(one: str, other: str) -> float:
    """WCAG 2: of 1 to 21."""
    darker, lighter = sorted(float(linear(each) @ TO_XYZ[1]) for each in (one, other))
    return (lighter + 0.05) / (darker + 0.05)


def lab(colour: str, eyes: str) -> np.ndarray:
    share = TO_XYZ @ np.clip(SEEN_BY[eyes] @ linear(colour), 0.0, 1.0) / WHITE
    x, y, z = np.where(share > 0.008856, np.cbrt(share), 7.787 * share + 16 / 116)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def test_contrast_and_distance_are_those_of_the_standards() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0, abs=0.01)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)
    assert lab("#ff0000", "all") == pytest.approx([53.2, 80.1, 67.2], abs=0.1)
    red, green = (lab(colour, "no green") for colour in ("#a04000", "#5a6000"))
    assert math.dist(red, green) < APART < math.dist(lab("#a04000", "all"), lab("#5a6000", "all"))


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_and_lines_stand_out(scheme: str) -> None:
    found = colours(scheme)
    low = [
        (name, ground)
        for names, ground, least in ((TEXTS, "card", 4.5), (TEXTS, "back", 4.5), (LINES, "card", 3.0))
        for name in names
        if contrast(found[name], found[ground]) < least
    ]
    assert low == []
    assert contrast(found["on-accent"], found["accent"]) >= 4.5
    assert contrast(found["text"], found["metal"]) >= 4.5


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("eyes", SEEN_BY)
@pytest.mark.parametrize("group", TOLD_APART)
def test_what_colours_tell_is_told_to_all(scheme: str, eyes: str, group: str) -> None:
    found = colours(scheme)
    alike = [
        pair
        for pair in itertools.combinations(TOLD_APART[group], 2)
        if math.dist(*(lab(found[name], eyes) for name in pair)) < APART
    ]
    assert alike == []


def test_there_is_one_scale_of_type() -> None:
    plain = dict(re.findall(r"^([a-z0-9, .:()-]+) \{[^}]*?font-size: ([^;]+);", CSS, re.MULTILINE))
    scaled = {name for name, size in plain.items() if size.startswith("var(--t-")}
    assert scaled >= {"h1", "h2", "h3", "h4", "header p", ".name", ".hint", ".soft", "thead th", "figcaption"}
