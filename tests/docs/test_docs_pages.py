"""Pages of docs/ and the files beside them: lines, links, paths of modules, decisions, lists that follow the code."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
BESIDE = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]
DECISIONS = sorted((DOCS / "decisions").glob("0*.md"))
WIDTH = 120

FENCE = re.compile(r"^ *(```+|~~~+).*?^ *\1 *$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"!?\[[^\[\]]*\]\(([^()\s]+)\)")
MODULE = re.compile(r"(?<![\w/.-])(?:app|benchmarks|catalogue|docker|docs|examples|solver|src|tests)/[\w./-]*\w/?")
DOTTED = re.compile(r"\bjointplay(?:\.[a-z_0-9]+)+")


def named(page: Path) -> str:
    return str(page.relative_to(ROOT))


def prose(page: Path) -> str:
    """Text of a page without its blocks of code."""
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def anchors(page: Path) -> set[str]:
    """What can stand after # in a link to this page: headings as GitHub and MyST name them."""
    headings = re.findall(r"^#{1,4} (.+)$", prose(page), re.MULTILINE)
    slugs = [re.sub(r"[^\w\- ]", "", LINK.sub("", each).lower()).replace(" ", "-") for each in headings]
    return {slug if slugs[:place].count(slug) == 0 else f"{slug}-{slugs[:place].count(slug)}"
            for place, slug in enumerate(slugs)}  # fmt: skip


@pytest.mark.parametrize("page", [*PAGES, *BESIDE], ids=named)
def test_lines_are_no_longer_than_the_code(page: Path) -> None:
    lines = prose(page).splitlines()
    assert not [line for line in lines if len(line) > WIDTH and not line.lstrip().startswith("|")]


@pytest.mark.parametrize("page", [*PAGES, *BESIDE], ids=named)
def test_links_lead_somewhere(page: Path) -> None:
    for target in LINK.findall(prose(page)):
        if target.startswith(("http://", "https://", "mailto:")):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        assert file.exists(), target
        if anchor:
            assert anchor in anchors(file), target


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_every_page_is_in_a_list(page: Path) -> None:
    folder = page.parent if page.name != "index.md" else page.parent.parent
    if page == DOCS / "index.md":
        return
    entry = page.relative_to(folder).with_suffix("").as_posix()
    listed = re.findall(r"```\{toctree\}\n(.*?)```", (folder / "index.md").read_text(encoding="utf-8"), re.DOTALL)
    assert any(entry in block.split() or ("0*" in block.split() and page in DECISIONS) for block in listed)


def tracked(name: str, base: Path = ROOT) -> bool:
    """Whether a folder, the checkout, has a file or folder of this name, perhaps said without its ending."""
    path = base / name
    return path.exists() or bool(list(path.parent.glob(f"{path.name}[.-]*")))


def of_the_present() -> Iterator[Path]:
    """Pages that speak of what is there; a decision speaks of its time."""
    yield from (page for page in [*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"] if page not in DECISIONS)
    yield DOCS / "explanation" / "pipeline.svg"


@pytest.mark.parametrize("page", list(of_the_present()), ids=named)
def test_files_that_are_named_are_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    missing = {name for name in MODULE.findall(text) if not (tracked(name) or tracked(name, page.parent))}
    for name in set(DOTTED.findall(text)):
        module = name.removeprefix("jointplay.").replace(".", "/")
        holds = [ROOT / f"{module}{end}" for end in (".py", "/__init__.py")]
        parent = ROOT / f"{module.rpartition('/')[0]}.py"  # a name of a module
        if not any(each.exists() for each in (*holds, parent)) and name.count(".") > 1:
            missing.add(name)
    assert not missing


@pytest.mark.parametrize("page", list(of_the_present()), ids=named)
def test_commands_that_are_named_are_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for module in re.findall(r"python -m (benchmarks[.\w]*|second_simulator|jointplay[.\w]+)", text):
        places = ROOT / "tests" if module == "second_simulator" else ROOT
        file = places / module.removeprefix("jointplay.").replace(".", "/")
        assert file.with_suffix(".py").is_file() or (file / "__main__.py").is_file(), module
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert set(re.findall(r"(?:^|`)make ([a-z-]+)", text, re.MULTILINE)) <= set(targets)
    for test in re.findall(r"pytest [^`]*", text):
        assert all((ROOT / each).exists() for each in re.findall(r"tests/[\w/.]+", test)), test


def test_pages_that_code_names_are_there() -> None:
    for folder in ("app", "benchmarks", "catalogue", "solver", "src"):
        for source in (ROOT / folder).rglob("*.*"):
            if source.suffix in (".py", ".yaml", ".html", ".js"):
                text = source.read_text(encoding="utf-8")
                for name in re.findall(r"\bdocs/[\w/.-]*\w", text):
                    assert tracked(name), f"{source}: {name}"


@pytest.mark.parametrize("page", DECISIONS, ids=named)
def test_a_decision_has_number_date_and_status(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    head = re.match(r"# (\d{4}) .+\n\n\* Date: 20\d\d-\d\d-\d\d\n\* Status: ((?:.|\n)+?)\n\n", text)
    assert head is not None
    assert re.fullmatch(rf"{head[1]}-[a-z0-9-]+\.md", page.name)
    status = " ".join(head[2].split())
    by = re.findall(r"\[(\d{4})\]\(\1-[a-z0-9-]+\.md\)", status)
    if status == "accepted":
        return
    assert re.match(r"overturned (in part )?by \[", status), status
    assert by and all(each > head[1] for each in by)


def test_decisions_are_counted_and_listed() -> None:
    assert [page.name[:4] for page in DECISIONS] == [f"{number:04d}" for number in range(1, len(DECISIONS) + 1)]
    index = (DOCS / "decisions" / "index.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| \[\d{4}\]\((.+?)\) \|.*\| (.+?) \|$", index, re.MULTILINE))
    assert list(rows) == [page.name for page in DECISIONS]
    for page in DECISIONS:
        status = page.read_text(encoding="utf-8").partition("* Status: ")[2].partition("\n\n")[0]
        assert set(re.findall(r"\[(\d{4})\]", rows[page.name])) == set(re.findall(r"\[(\d{4})\]", status)), page.name
        assert rows[page.name].split()[0] == status.split()[0], page.name


def additions() -> dict[str, list[str]]:
    """What can be added, and in which files: the sections of the page that have such a list."""
    sections = re.split(r"^## ", (DOCS / "guide" / "extending.md").read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    lists = {section.partition("\n")[0]: re.findall(r"^\d\. `([^`]+)`", section, re.MULTILINE) for section in sections}
    return {name: files for name, files in lists.items() if files}


def test_additions_are_described() -> None:
    assert set(additions()) >= {
        "A contact law", "A machine element", "A file format", "An evaluation protocol", "An HTTP operation",
        "A member of the answer", "A command",
    }  # fmt: skip


@pytest.mark.parametrize(("name", "files"), list(additions().items()))
def test_an_addition_takes_four_files(name: str, files: list[str]) -> None:
    assert 1 <= len(files) <= 4
    for file in files:
        assert (ROOT / file).is_file(), file


def test_the_page_of_the_command_line_is_as_made() -> None:
    described = importlib.util.spec_from_file_location("command_line_page", DOCS / "command_line.py")
    assert described is not None and described.loader is not None
    made = importlib.util.module_from_spec(described)
    sys.modules[described.name] = made
    described.loader.exec_module(made)
    assert made.PAGE.read_text(encoding="utf-8") == made.page(), "run `python docs/command_line.py`"


def test_the_files_of_make_quick_are_there() -> None:
    done = subprocess.run(["make", "-n", "quick"], cwd=ROOT, capture_output=True, text=True, check=True)
    files = re.findall(r"\btests/[\w/]+\.py", done.stdout)
    assert len(files) > 10 and all((ROOT / file).is_file() for file in files)
