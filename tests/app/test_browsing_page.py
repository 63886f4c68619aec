"""The catalogue browser: the nearest entry beside the healthy machine, with and without a browser."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from jointplay.catalogue.storage.store import Catalogue


def charts(text: str) -> list[dict[str, list[float]]]:
    return [json.loads(html.unescape(found)) for found in re.findall(r'data-chart="([^"]+)"', text)]


def test_the_list_leads_to_the_browser(client: httpx.Client) -> None:
    text = client.get("/catalogues").text
    assert 'href="/catalogues/slider-crank"' in text
    assert client.get("/catalogues/slider-crank").status_code == 200


def test_the_nearest_entry_is_shown_beside_healthy(client: httpx.Client, shelf: Path) -> None:
    response = client.get("/catalogues/slider-crank", params={"hypothesis": "B", "clearance": "0.2 mm"})
    assert response.status_code == 200
    catalogue = Catalogue.open(shelf / "slider-crank")
    matrix = catalogue.matrix
    rows = matrix.rows("B", "trusted")
    column = matrix.joints.index("B")
    best = rows[np.argmin(np.abs(np.log(matrix.clearance(rows)[:, column] / 200e-6)))]
    key = str(matrix.table(np.array([best])).key[0])
    assert key in response.text
    assert (
        f"B at {1e6 * matrix.clearance(np.array([best]))[0, column]:.0f} µm, against a machine in order"
        in response.text
    )
    (virtual,) = re.findall(r'href="(/try\?[^"]+)"', response.text)
    size = re.findall(r'name="wear-B"[^>]* value="([^"]+)"', client.get(html.unescape(virtual)).text)
    assert float(size[0]) == pytest.approx(1e6 * matrix.clearance(np.array([best]))[0, column], rel=1e-3)
    shown = charts(response.text)
    assert len(shown) == 3
    healthy, *_family, entry = shown[1]["lines"]
    assert [line["name"] for line in (healthy, entry)] == ["in order", "this entry"]  # type: ignore[call-overload]
    expected = 10 * np.log10(matrix.packed(np.array([best]))[0, :, 1])
    np.testing.assert_allclose(entry["levels"], np.maximum(expected, -100), atol=1e-3)  # type: ignore[call-overload]
    sound = 10 * np.log10(matrix.packed(matrix.rows("healthy", "trusted"))[..., 1])
    np.testing.assert_allclose(healthy["levels"], np.maximum(np.median(sound, axis=0), -100), atol=1e-3)  # type: ignore[call-overload]


def test_wear_is_shown_over_clearance_beside_machines_with_new_fits(client: httpx.Client, shelf: Path) -> None:
    text = client.get("/catalogues/slider-crank", params={"hypothesis": "B", "clearance": "200"}).text
    matrix = Catalogue.open(shelf / "slider-crank").matrix
    fits = matrix.clearance(matrix.rows("healthy", "trusted"))
    assert np.median(fits.max(axis=1)) > 1e-6, "machines in order have the play of a new fit, and are no ideal ones"
    lines: list[dict[str, Any]] = charts(text)[1]["lines"]  # type: ignore[assignment]
    family = [line for line in lines if line["look"] == "rival"]
    shares = [line["share"] for line in family]
    assert shares[0] == 0 and shares[-1] == 1 and shares == sorted(set(shares))  # a colour each
    sizes = [float(size) * {"µm": 1.0, "mm": 1e3}[unit] for size, unit in (line["name"].split() for line in family)]
    assert len(sizes) == 4 and sizes == sorted(sizes) and sizes[-1] > 5 * sizes[0]
    loud = [np.mean(line["levels"][20:]) for line in family]
    assert loud[-1] > loud[0] + 3, "more wear is louder"
    said = re.findall(r"<li>[^<]+: ([+−]\d+\.\d) dB at order", text)
    assert said and all(abs(float(each.replace("−", "-"))) < 60 for each in said)


def test_the_baseline_of_an_asset_is_shown(client: httpx.Client, in_order: bytes) -> None:
    place = "/catalogues/slider-crank"
    sent = client.post("/api/v1/measurements", files={"file": ("in-order.csv", in_order)}).json()
    client.put("/api/v1/assets/browsed-1", json={"machine": "slider-crank", "baseline": sent["id"]})
    client.put("/api/v1/assets/browsed-2", json={"machine": "slider-crank"})
    text = client.get(place, params={"hypothesis": "B", "asset": "browsed-1"}).text
    assert "baseline of browsed-1" in text and ">browsed-2</option>" not in text
    chart: dict[str, Any] = charts(text)[1]
    known = {line["name"]: np.array(line["levels"], dtype=float) for line in chart["lines"]}
    off = known["baseline"] - known["in order"]
    low, high = (np.array(chart[end]) - known["in order"] for end in ("lower", "upper"))
    assert np.nanmean((off > low - 3) & (off < high + 3)) > 0.9, (
        "it is in order: its sensors' noise alone may be louder"
    )
    refused = client.get(place, params={"hypothesis": "B", "asset": "browsed-2"})
    assert (refused.status_code, "browsed-2: has no baseline" in refused.text) == (422, True)
    assert client.get(place, params={"hypothesis": "B", "asset": "nonsense"}).status_code == 404


@pytest.mark.parametrize("channel", [0, 2])
def test_levels_are_of_the_quantity_and_in_the_scaling_asked_for(
    client: httpx.Client, shelf: Path, channel: int
) -> None:
    def shown(**options: str) -> str:
        return client.get("/catalogues/slider-crank", params={"hypothesis": "B", **options}).text

    text = shown()
    plain = charts(text)[channel]
    assert plain == charts(shown(quantity="acceleration", scaling="rms"))[channel]
    (key,) = re.findall(r'key-text">(\w+)<', text)
    speed = Catalogue.open(shelf / "slider-crank").entry(key).drive_speed
    rate, unit = speed * np.asarray(plain["orders"]), ("m", "m", "rad")[channel]
    for power, quantity, per in ((1, "velocity", "/s"), (2, "displacement", "")):
        found = charts(shown(quantity=quantity, scaling="peak"))[channel]
        assert found["label"] == f"dB re 1 {unit}{per} peak"
        for line, before in zip(found["lines"], plain["lines"], strict=True):
            # A peak is the root of 2 of the rms, and a band's motion that of a sine at its middle.
            expected = before["levels"] - 20 * power * np.log10(rate) + 10 * np.log10(2)  # type: ignore[call-overload]
            np.testing.assert_allclose(line["levels"], expected, atol=1e-6)  # type: ignore[call-overload]
    density = charts(shown(scaling="psd"))[channel]
    assert density["label"] == f"dB re 1 ({unit}/s²)²/Hz"
    width = speed / (2 * np.pi)  # of one order, Hz
    assert density["upper"][0] == pytest.approx(plain["upper"][0] - 10 * np.log10(width))


def test_a_number_alone_is_in_micrometres(client: httpx.Client) -> None:
    place = "/catalogues/slider-crank"
    first = client.get(place, params={"hypothesis": "B", "clearance": "200"}).text
    second = client.get(place, params={"hypothesis": "B", "clearance": "0.2 mm"}).text
    assert charts(first) == charts(second)


def test_the_healthy_machine_can_be_looked_at(client: httpx.Client) -> None:
    response = client.get("/catalogues/slider-crank", params={"hypothesis": "healthy"})
    assert response.status_code == 200
    assert "healthy, against a machine in order" in response.text


@pytest.mark.parametrize(
    ("fields", "field", "text"),
    [
        ({"clearance": "wide"}, "clearance", "clearance: wide"),
        ({"clearance": "-1"}, "clearance", "greater than 0"),
        ({"clearance": "2 m"}, "clearance", "at most 100 mm"),
        ({"hypothesis": "<b>"}, "hypothesis", "&lt;b&gt;"),
        ({"quantity": "jerk"}, "quantity", "jerk: must be one of displacement, velocity, acceleration"),
        ({"scaling": "loud"}, "scaling", "loud: must be one of psd, power, rms, peak"),
    ],
)
@pytest.mark.parametrize("htmx", [True, False])
def test_a_wrong_field_is_told_beside_it(
    client: httpx.Client, fields: dict[str, str], field: str, text: str, htmx: bool
) -> None:
    headers = {"HX-Request": "true"} if htmx else {}
    response = client.get("/catalogues/slider-crank", params=fields, headers=headers)
    assert response.status_code == 422
    assert ("<html" in response.text) != htmx
    found = re.search(rf'id="error-{field}"[^>]*>([^<]*)</p>', response.text)
    assert found is not None and text in found[1]


def test_an_unknown_catalogue_is_a_page(client: httpx.Client) -> None:
    response = client.get("/catalogues/nonsense")
    assert response.status_code == 404
    assert "No such catalogue" in response.text
