"""A report as one self-contained HTML page that prints on one sheet of A4."""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from jointplay.app.reports.content import JOINT_COLUMNS, Report
from jointplay.app.reports.figures import Figures

TEMPLATES = Path(__file__).parent.parent / "templates" / "report"


def html(report: Report, figures: Figures) -> str:
    """Return the page.

    Parameters
    ----------
    report : Report
        Every text in it is escaped.
    figures : Figures
        SVG of our own making.
    """
    template = environment().get_template("report.html")
    return template.render(report=report, figures=figures, style=style(), joint_columns=JOINT_COLUMNS)


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
