"""A report as one self-contained HTML page and as PDF (ReportLab): one sheet of A4, figures from the same SVG."""

from __future__ import annotations

import base64
import hashlib
import io
import threading
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from jointplay.app.reports.content import JOINT_COLUMNS, Named, Report
from jointplay.app.reports.figures import ReportFigures

REGULAR, BOLD, OBLIQUE = "DejaVuSans", "DejaVuSans-Bold", "DejaVuSans-Oblique"
MM = 72 / 25.4
WIDTH, HEIGHT = 210 * MM, 297 * MM
MARGIN = 11 * MM
GUTTER = 5 * MM
FIGURE_HEIGHT = 46 * MM
ACCENT, SOFT, LINE, BACK = "#1f5fa8", "#566373", "#d4dae1", "#f3f5f8"
SIDES = {"worn": "#c2570c", "in_order": "#1d7a46", "changed": "#6b4fa0", "unknown": "#7a5b00"}
RESPONSE = "What the frame answers to forces. Dashed: orders that the drive shakes it with."

_lock = threading.Lock()  # the library keeps fonts and styles for the whole process


def pdf(report: Report, figures: ReportFigures) -> bytes:
    """Return the bytes of the document; what would need a second page is made smaller.

    Parameters
    ----------
    report : Report
    figures : ReportFigures
    """
    from reportlab.pdfgen.canvas import Canvas
    from reportlab.platypus import Frame, KeepInFrame

    with _lock:
        fonts()
        wide, high = WIDTH - 2 * MARGIN, HEIGHT - 2 * MARGIN
        target = io.BytesIO()
        # Invariant: no time of writing inside, so that the same report is the same bytes.
        canvas = Canvas(target, pagesize=(WIDTH, HEIGHT), invariant=1)
        canvas.setTitle(report.title)
        canvas.setSubject(report.sentence)
        canvas.setCreator("jointplay")
        frame = Frame(MARGIN, MARGIN, wide, high, 0, 0, 0, 0)
        frame.addFromList([KeepInFrame(wide, high, content(report, figures, wide), mode="shrink")], canvas)
        canvas.showPage()
        canvas.save()
    return target.getvalue()


def content(report: Report, figures: ReportFigures, wide: float) -> list[Any]:
    """Return the parts of the page from top to bottom."""
    half = (wide - GUTTER) / 2
    left = [
        heading("Asset and measurement"),
        facts(report.facts, half, 7.5),
        heading("How likely"),
        *texts(report.likelihood),
        heading("How large"),
        *texts(report.severity),
    ]
    right = [
        heading("Mechanism"),
        drawing(figures.mechanism, half, 1.35 * FIGURE_HEIGHT),
        text("The deeper the colour of a joint, the more probable its wear.", 6.8, SOFT),
        *([drawing(figures.response, half, FIGURE_HEIGHT), text(RESPONSE, 6.8, SOFT)] if figures.response else []),
    ]
    told = [heading("What would tell the first two apart"), *texts(report.suggestions, bullet=True)]
    done = [heading("Recommended inspection"), *texts(report.inspection, bullet=True)]
    done += [heading("Limits"), *(text(line, 6.8, SOFT) for line in report.limits)]
    if report.warnings:
        told += [heading("Warnings"), *texts(report.warnings, bullet=True)]
    third = wide / max(len(figures.spectra), 3)
    spectra = [drawing(each, third - 2 * MM, FIGURE_HEIGHT) for each in figures.spectra]
    return [
        text(report.title, 14, bold=True),
        verdict(report, wide),
        *texts(report.remarks),
        beside(left, right, half),
        *([heading("Joints"), joints(report.joints, wide)] if report.joints else []),
        heading("Hypotheses"),
        ranking(report.hypotheses, wide),
        heading("Measured against matched levels"),
        *([table([spectra], [third] * len(spectra))] if spectra else []),
        text(figures.caption, 6.8, SOFT),
        beside(done, told, half),
        heading("Method"),
        facts(report.method, wide, 6.3),
    ]


def text(line: str, size: float = 7.8, colour: str = "#16202b", bold: bool = False, bullet: bool = False) -> Any:
    """Return a paragraph; nothing in it is read as markup."""
    from reportlab.lib.styles import ParagraphStyle
    from reportlab.platypus import Paragraph

    style = ParagraphStyle(
        "text",
        fontName=BOLD if bold else REGULAR,
        fontSize=size,
        leading=1.28 * size,
        textColor=colour,
        spaceAfter=1.5,
        leftIndent=8 if bullet else 0,
        splitLongWords=1,
    )
    return Paragraph(escape(line), style, bulletText="•" if bullet else None)


def texts(lines: Sequence[str], bullet: bool = False) -> list[Any]:
    """Return several paragraphs."""
    return [text(line, bullet=bullet) for line in lines]


def heading(line: str) -> Any:
    """Return the heading of a part."""
    found = text(line, 8.8, ACCENT, bold=True)
    found.style.spaceBefore = 5
    return found


def verdict(report: Report, wide: float) -> Any:
    """Return the sentence that matters, with a bar at its side."""
    return table(
        [[text(report.sentence, 10, bold=True)]],
        [wide],
        ("BACKGROUND", (0, 0), (-1, -1), BACK),
        ("LINEBEFORE", (0, 0), (0, -1), 3, SIDES[report.verdict]),
        ("LEFTPADDING", (0, 0), (-1, -1), 7),
    )


def facts(rows: Sequence[Named], wide: float, size: float) -> Any:
    """Return a table of names and values."""
    first = 20 * MM
    cells = [[text(row.name, size, SOFT), text(row.value, size)] for row in rows]
    return table(cells, [first, wide - first], ("LINEBELOW", (0, 0), (-1, -1), 0.4, LINE))


def ranking(rows: Sequence[Sequence[str]], wide: float) -> Any:
    """Return the table of hypotheses."""
    names = ("Worn", "Probability", "Radial clearance (90 % interval)", "Distance")
    return make_list(names, rows, wide, (0.2, 0.15, 0.5, 0.15))


def joints(rows: Sequence[Sequence[str]], wide: float) -> Any:
    """Return the table of joints."""
    return make_list(JOINT_COLUMNS, rows, wide, (0.1, 0.15, 0.15, 0.25, 0.15, 0.2))


def make_list(names: Sequence[str], rows: Sequence[Sequence[str]], wide: float, parts: Sequence[float]) -> Any:
    """Return a table with names of its columns, which take parts of the width."""
    cells = [[text(name, 7.5, SOFT) for name in names], *([text(cell, 7.5) for cell in row] for row in rows)]
    return table(cells, [wide * part for part in parts], ("LINEBELOW", (0, 0), (-1, -1), 0.4, LINE))


def beside(left: Sequence[Any], right: Sequence[Any], half: float) -> Any:
    """Return two columns."""
    return table([[list(left), "", list(right)]], [half, GUTTER, half])


def table(cells: Sequence[Sequence[Any]], widths: Sequence[float], *commands: tuple[Any, ...]) -> Any:
    """Return cells without padding at the sides."""
    from reportlab.platypus import Table

    plain = [
        ("VALIGN", (0, 0), (-1, -1), "TOP"),
        ("LEFTPADDING", (0, 0), (-1, -1), 0),
        ("RIGHTPADDING", (0, 0), (-1, -1), 0),
        ("TOPPADDING", (0, 0), (-1, -1), 1),
        ("BOTTOMPADDING", (0, 0), (-1, -1), 0.5),
    ]
    return Table(list(map(list, cells)), colWidths=list(widths), style=[*plain, *commands], hAlign="LEFT")


def drawing(svg: str, widest: float, highest: float) -> Any:
    """Return an SVG of our own as a drawing of a bounded size."""
    from svglib.svglib import svg2rlg

    own = svg.replace("system-ui, sans-serif", REGULAR)
    found: Any = svg2rlg(io.BytesIO(own.encode()))
    scale = min(widest / found.width, highest / found.height)
    found.scale(scale, scale)
    found.width, found.height = found.width * scale, found.height * scale
    return found


@cache
def fonts() -> None:
    """Make DejaVu Sans known, which comes with matplotlib and has Greek, Cyrillic and the signs of units."""
    import matplotlib
    from reportlab.lib.fonts import addMapping
    from reportlab.pdfbase.pdfmetrics import registerFont
    from reportlab.pdfbase.ttfonts import TTFont
    from svglib.fonts import register_font

    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    for name in (REGULAR, BOLD, OBLIQUE):
        registerFont(TTFont(name, folder / f"{name}.ttf"))
    for bold, italic, name in ((0, 0, REGULAR), (1, 0, BOLD), (0, 1, OBLIQUE), (1, 1, BOLD)):
        addMapping(REGULAR, bold, italic, name)
    register_font(REGULAR, str(folder / f"{REGULAR}.ttf"))
    register_font(REGULAR, str(folder / f"{BOLD}.ttf"), weight="bold", rlgFontName=BOLD)
    register_font(REGULAR, str(folder / f"{OBLIQUE}.ttf"), style="italic", rlgFontName=OBLIQUE)


TEMPLATES = Path(__file__).parent.parent / "templates" / "report"


def html(report: Report, figures: ReportFigures) -> str:
    """Return the page.

    Parameters
    ----------
    report : Report
        Every text in it is escaped.
    figures : ReportFigures
        SVG of our own making.
    """
    template = environment().get_template("report.html")
    return template.render(
        report=report, figures=figures, response=RESPONSE, style=style(), joint_columns=JOINT_COLUMNS
    )


def policy() -> str:
    """Return the content security policy of the page: its own style sheet, by its hash, and nothing else."""
    digest = base64.b64encode(hashlib.sha256(style().encode()).digest()).decode()
    return (
        f"default-src 'none'; style-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


@cache
def style() -> str:
    """Return the style sheet."""
    return (TEMPLATES / "report.css").read_text(encoding="utf-8")


@cache
def environment() -> Environment:
    """Return the templates; text is escaped, and a name that is not there is an error."""
    return Environment(loader=FileSystemLoader(TEMPLATES), autoescape=True, undefined=StrictUndefined)
