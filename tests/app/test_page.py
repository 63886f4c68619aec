"""The page without a browser: what it loads, what it says, and that it works without scripts."""

from __future__ import annotations

import hashlib
import re
from html.parser import HTMLParser
from pathlib import Path

import httpx
import pytest
from small_service import spoiled

from app import main

VENDOR = main.STATIC / "vendor"


class Page(HTMLParser):
    """Collects what the tests ask about."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.inline: list[str] = []
        self.ids: list[str] = []
        self.labels: set[str] = set()
        self.fields: list[dict[str, str | None]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        found = dict(attributes)
        if tag in ("script", "img", "link", "source", "iframe"):
            place = found.get("src") or found.get("href")
            self.loaded.append(place) if place else self.inline.append(tag)
        self.inline += [name for name in found if name == "style" or name.startswith("on")]
        self.inline += [tag] if tag == "style" else []
        if identity := found.get("id"):
            self.ids.append(identity)
        if tag == "label" and found.get("for"):
            self.labels.add(str(found["for"]))
        if tag in ("input", "select", "textarea"):
            self.fields.append(found)


def ask(client: httpx.Client, content: bytes | None, *, htmx: bool = False, **fields: str) -> httpx.Response:
    files = {"file": ("worn.csv", content)} if content is not None else {"file": ("", b"")}
    headers = {"HX-Request": "true"} if htmx else {}
    return client.post(
        "/diagnose", data={"catalogue": "slider-crank", "effort": "fast", **fields}, files=files, headers=headers
    )


def error_of(text: str, field: str) -> str:
    found = re.search(rf'<p class="error" id="error-{field}"[^>]*>([^<]*)</p>', text)
    assert found is not None
    return found[1]


def test_only_own_files_are_loaded(client: httpx.Client) -> None:
    page = Page(client.get("/").text)
    assert page.loaded
    assert all(place.startswith("/static/") for place in page.loaded)
    assert not page.inline
    for place in page.loaded:
        assert client.get(place).status_code == 200
    for name in ("page.css", "page.js", "charts.js"):
        assert not re.search(r"https?:|@import|url\(", (main.STATIC / name).read_text(encoding="utf-8"))


def test_vendored_files_are_those_of_the_table() -> None:
    table = (VENDOR / "README.md").read_text(encoding="utf-8")
    listed = dict(re.findall(r"^\| `([^`]+)` .* \| `([0-9a-f]{64})` \|$", table, re.MULTILINE))
    files = {path.name for path in VENDOR.iterdir() if path.suffix in (".js", ".css")}
    assert set(listed) == files
    for name, checksum in listed.items():
        assert hashlib.sha256((VENDOR / name).read_bytes()).hexdigest() == checksum
    assert all((VENDOR / name).is_file() for name in re.findall(r"`([a-z]+-LICENSE\.txt)`", table))


def test_every_field_has_a_label_and_a_place_for_its_error(client: httpx.Client) -> None:
    page = Page(client.get("/").text)
    assert len(page.ids) == len(set(page.ids))
    for field in page.fields:
        assert field["id"] in page.labels
        described = str(field["aria-describedby"]).split()
        assert f"error-{field['name']}" in described
        assert set(described) <= set(page.ids)


def test_the_form_works_without_scripts(client: httpx.Client, worn: bytes) -> None:
    response = ask(client, worn)
    assert response.status_code == 303
    page = client.get(response.headers["location"])
    assert page.status_code == 200
    assert "Joint B is worn: radial clearance" in page.text
    assert "<title>B worn: jointplay</title>" in page.text
    assert page.text.index('id="result"') < page.text.index('id="ask"')
    assert not Page(page.text).inline
    assert len(Page(page.text).ids) == len(set(Page(page.text).ids))


def test_htmx_gets_a_fragment(client: httpx.Client, worn: bytes) -> None:
    response = ask(client, worn, htmx=True, speed="606.8")
    assert response.status_code == 200
    assert "<html" not in response.text
    assert "Joint B is worn" in response.text
    assert "606.8 rpm" in response.text
    assert response.headers["hx-push-url"].startswith("/diagnoses/")
    assert error_of(response.text, "file") == ""


@pytest.mark.parametrize(
    ("fields", "field", "text"),
    [
        ({"speed": "fast"}, "speed", "speed: fast: "),
        ({"speed": "-3"}, "speed", "greater than 0"),
        ({"sample_rate": "3 kg"}, "sample_rate", "3 kg"),
        ({"mapping": "left"}, "mapping", "must be column = sensor"),
        ({"mapping": "a = b\na = c"}, "mapping", "is given twice"),
        ({"catalogue": "nonsense"}, "catalogue", "there is none"),
        ({"effort": "much"}, "effort", "fast"),
    ],
)
@pytest.mark.parametrize("htmx", [True, False])
def test_a_wrong_field_is_told_beside_it(
    client: httpx.Client, worn: bytes, fields: dict[str, str], field: str, text: str, htmx: bool
) -> None:
    response = ask(client, worn, htmx=htmx, **fields)
    assert response.status_code in (404, 422)
    assert response.headers["content-type"].startswith("text/html")
    assert text in error_of(response.text, field)
    others = {"catalogue", "file", "speed", "effort", "mapping", "sample_rate"} - {field}
    assert not any(error_of(response.text, other) for other in others)


@pytest.mark.parametrize("kind", ["no number", "short"])
def test_a_bad_recording_is_told_beside_the_file(client: httpx.Client, worn: bytes, kind: str) -> None:
    response = ask(client, spoiled(worn, kind), htmx=True)
    assert response.status_code == 422
    assert error_of(response.text, "file").startswith("worn.csv: ")


def test_a_missing_file_is_told_beside_it(client: httpx.Client) -> None:
    assert error_of(ask(client, None, htmx=True).text, "file") == "choose a recording"


def test_a_large_file_is_told_beside_it(client: httpx.Client) -> None:
    response = ask(client, b"0" * 3_100_000, htmx=True)
    assert response.status_code == 413
    assert "3 MB" in error_of(response.text, "file")


def test_what_was_typed_stays_and_cannot_become_markup(client: httpx.Client, worn: bytes) -> None:
    response = ask(client, worn, speed='"><script>alert(1)</script>')
    assert response.status_code == 422
    assert "<script>alert" not in response.text
    assert "&lt;script&gt;" in response.text


def test_a_hostile_file_name_is_text(client: httpx.Client, worn: bytes) -> None:
    response = client.post(
        "/diagnose",
        files={"file": ("<img src=x onerror=alert(1)>.csv", worn)},
        data={"catalogue": "slider-crank", "effort": "fast"},
        headers={"HX-Request": "true"},
    )
    assert response.status_code == 200
    assert "<img" not in response.text


def test_an_unknown_result_is_a_page(client: httpx.Client) -> None:
    response = client.get("/diagnoses/nonsense")
    assert response.status_code == 404
    assert "No such diagnosis" in response.text


def test_static_files_are_packaged() -> None:
    assert Path(main.STATIC / "page.css").is_file()
