"""Plots of the page, as SVG."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("svg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from benchmarks.comparison import LIMIT_DB

_SIZE = (7.0, 4.2)


def _save(figure: Figure, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.tight_layout()
    # Neither dates nor random names: equal figures give equal files.
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def _comparison(curves: list[dict[str, Any]], title: str) -> Figure:
    figure, axes = plt.subplots(figsize=(_SIZE[0], 5.2))
    for k, curve in enumerate(curves):
        if curve["points"]:
            cost = [point["cost"] for point in curve["points"]]
            error = [max(point["error"], 1e-3) for point in curve["points"]]
            axes.loglog(cost, error, marker="osD^v<>PX*"[k % 10], markersize=4, linewidth=1, label=curve["program"])
    axes.axhline(LIMIT_DB, color="black", linewidth=0.8, linestyle=":")
    axes.set(title=title, xlabel="processor seconds per simulated second", ylabel="harmonic error, dB")
    axes.legend(fontsize=6.5, loc="best")
    axes.grid(True, which="major", alpha=0.3)
    return figure


def _links(rows: list[dict[str, Any]]) -> Figure:
    figure, axes = plt.subplots(figsize=_SIZE)
    moving = [row["moving"] for row in rows]
    for key, label, scale in (("ns", "right-hand side, ns a lane", 1.0), ("operations", "vector operations", 1.0),
                              ("dense_ms", "dense NumPy solution, ns", 1e6)):  # fmt: skip
        axes.loglog(moving, [scale * row[key] for row in rows], marker="o", markersize=4, label=label)
    axes.set(xlabel="moving links", ylabel="cost")
    axes.legend(fontsize=8)
    axes.grid(True, which="major", alpha=0.3)
    return figure


def _clearances(rows: list[dict[str, Any]]) -> Figure:
    figure, (left, right) = plt.subplots(1, 2, figsize=_SIZE)
    for name in dict.fromkeys(row["machine"] for row in rows):
        own = [row for row in rows if row["machine"] == name]
        for axes, key in ((left, "ns"), (right, "cost")):
            axes.plot([row["open"] for row in own], [row[key] for row in own], marker="o", markersize=4, label=name)
    left.set(xlabel="clearances open at once", ylabel="right-hand side, ns a lane")
    right.set(xlabel="clearances open at once", ylabel="processor s per simulated s")
    for axes in (left, right):
        axes.set_ylim(bottom=0)
        axes.grid(True, alpha=0.3)
    left.legend(fontsize=8)
    return figure


def draw(found: dict[str, Any], folder: Path) -> None:
    """Every plot for which there are figures."""
    with mpl.rc_context({"svg.hashsalt": "jointplay", "svg.fonttype": "none", "font.size": 9}):
        for name, title in (("p1", "P1"), ("qr", "QR")):
            if name in found:
                curves = found[name]["curves"] if name == "qr" else found[name]
                _save(_comparison(curves, title), folder / f"{name}.svg")
        if "links" in found:
            _save(_links(found["links"]), folder / "links.svg")
        if "clearances" in found:
            _save(_clearances(found["clearances"]), folder / "clearances.svg")
