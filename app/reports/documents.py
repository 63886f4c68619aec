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

from jointplay.app.reports.content import FORM_COLUMNS, JOINT_COLUMNS, Named, Report
from jointplay.app.reports.figures import INK, ReportFigures
from jointplay.app.reports.trend import SAID

REGULAR, BOLD, OBLIQUE = "DejaVuSans", "DejaVuSans-Bold", "DejaVuSans-Oblique"
MM = 72 / 25.4
WIDTH, HEIGHT = 210 * MM, 297 * MM
MARGIN = 11 * MM
GUTTER = 5 * MM
FIGURE_HEIGHT = 46 * MM
SCALES = (1.0, 0.95, 0.9, 0.85, 0.8, 0.7, 0.6, 0.5)
"""How small everything may become, so that all of it is on one sheet."""
ACCENT, SOFT, LINE, BACK = "#1f5fa8", "#566373", "#d4dae1", "#f3f5f8"
SIDES = {"worn": "#b54708", "in_order": "#0b6b8f", "changed": "#6b21a8", "unknown": "#626262"}
FINDING = "What was found (to be reported to this diagnosis)"
PAST = "State of wear of this asset up to here"
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
        # Invariant: no time of writing inside but that of the diagnosis, so that the same report is the same bytes.
        canvas = Canvas(target, pagesize=(WIDTH, HEIGHT), invariant=1)
        canvas.setDateFormatter(lambda *_: f"D:{report.at:%Y%m%d%H%M%S}+00'00'")
        canvas.setTitle(report.title)
        canvas.setSubject(report.sentence)
        canvas.setCreator("jointplay")
        canvas.setKeywords(report.evidence)
        for scale in SCALES:
            parts = content(report, figures, wide / scale)
            room = high / scale - height_of(parts, wide / scale, high)
            if room >= 0:
                break
        parts = content(report, figures, wide / scale, max(room, 0.0))
        canvas.scale(scale, scale)
        frame = Frame(MARGIN / scale, MARGIN / scale, wide / scale, high / scale, 0, 0, 0, 0)
        frame.addFromList([KeepInFrame(wide / scale, high / scale, parts, mode="shrink")], canvas)
        canvas.showPage()
        canvas.save()
    return target.getvalue()


def height_of(parts: Sequence[Any], wide: float, high: float) -> float:
    """Return how high parts are, one below the other."""
    return float(sum(part.wrap(wide, high)[1] + part.getSpaceBefore() + part.getSpaceAfter() for part in parts))


def content(report: Report, figures: ReportFigures, wide: float, room: float = 0.0) -> list[Any]:
    """Return the parts of the page from top to bottom; the box for the finding takes the room that is left."""
    half = (wide - GUTTER) / 2
    left = [heading("Asset and measurement"), facts(report.facts, half, 7.5)]
    right = [
        heading("Mechanism"),
        drawing(figures.mechanism, half, 1.35 * FIGURE_HEIGHT),
        text(report.colours, 6.8, SOFT),
        *([drawing(figures.response, half, FIGURE_HEIGHT), text(RESPONSE, 6.8, SOFT)] if figures.response else []),
    ]
    said = [heading("How likely"), *texts(report.likelihood), heading("How large"), *texts(report.severity)]
    done = [heading("Recommended inspection"), *texts(report.inspection, bullet=True)]
    done += [heading("What would tell the first two apart"), *texts(report.suggestions, bullet=True)]
    if report.warnings:
        done += [heading("Warnings"), *texts(report.warnings, bullet=True)]
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
        beside(said, done, half),
        *trend_and_form(report, figures, wide, room),
        heading("Limits"),
        *(text(line, 6.8, SOFT) for line in report.limits),
        heading("Method"),
        facts(report.method, wide, 6.3),
    ]


def trend_and_form(report: Report, figures: ReportFigures, wide: float, room: float) -> list[Any]:
    """Return the past of the asset beside the box for the finding, or that box alone."""
    half = (wide - GUTTER) / 2
    if not report.past:
        return [heading(FINDING), finding_box(report, wide, room)]
    past = [heading(PAST), *texts(report.past)]
    if figures.trend:
        past += [drawing(figures.trend, half, FIGURE_HEIGHT + room), text(SAID, 6.8, SOFT)]
    return [beside(past, [heading(FINDING), finding_box(report, half, room)], half)]


def finding_box(report: Report, wide: float, room: float) -> Any:
    """Return the box in which a fitter notes what was found, with so much more room for remarks."""
    names = [text(name, 7, SOFT) for name in FORM_COLUMNS]
    rows = [[text(cell, 7.5) for cell in (*row, "", "")] for row in report.form]
    cells = [
        names,
        *rows,
        [text("Remarks", 7, SOFT), "", "", ""],
        [text("Date", 7, SOFT), "", text("Name", 7, SOFT), text("Signature", 7, SOFT)],
    ]
    heights = [None, *([6 * MM] * len(rows)), 7 * MM + room, 6 * MM]
    widths = [wide * part for part in (0.13, 0.27, 0.33, 0.27)]
    return table(
        cells,
        widths,
        ("BOX", (0, 0), (-1, -1), 0.8, INK),
        ("INNERGRID", (0, 0), (-1, -3), 0.4, LINE),
        ("LINEABOVE", (0, -2), (-1, -1), 0.4, LINE),
        ("SPAN", (0, -2), (-1, -2)),
        ("LEFTPADDING", (0, 0), (-1, -1), 3),
        heights=heights,
    )


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


def table(
    cells: Sequence[Sequence[Any]],
    widths: Sequence[float],
    *commands: tuple[Any, ...],
    heights: Sequence[float | None] | None = None,
) -> Any:
    """Return cells without padding at the sides."""
    from reportlab.platypus import Table

    plain = [
        ("VALIGN", (0, 0), (-1, -1), "TOP"),
        ("LEFTPADDING", (0, 0), (-1, -1), 0),
        ("RIGHTPADDING", (0, 0), (-1, -1), 0),
        ("TOPPADDING", (0, 0), (-1, -1), 1),
        ("BOTTOMPADDING", (0, 0), (-1, -1), 0.5),
    ]
    found = list(map(list, cells))
    return Table(found, colWidths=list(widths), rowHeights=heights, style=[*plain, *commands], hAlign="LEFT")


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
        report=report,
        figures=figures,
        response=RESPONSE,
        style=style(),
        joint_columns=JOINT_COLUMNS,
        form_columns=FORM_COLUMNS,
        finding=FINDING,
        past=PAST,
        signs=SAID,
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
