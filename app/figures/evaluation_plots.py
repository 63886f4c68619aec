"""Figures of ``jointplay evaluate``: reliability of probabilities, and quality against cost."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from jointplay.app.figures.plots import BLUE, ORANGE, save
from jointplay.catalogue.evaluation.study import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from jointplay.catalogue.evaluation.sweep import Point, Sweep

COLOURS = (BLUE, ORANGE, "#3a8a3a", "#7a4fa0", "#8a6d1f", "#555555")


def plot_evaluation(found: Study | Sweep, path: Path) -> None:
    """Draw a study's reliability, or what a sweep's catalogues cost and gain."""
    figure = Figure(figsize=(11, 5), layout="constrained")
    left, right = figure.subplots(1, 2)
    if isinstance(found, Study):
        figure.suptitle(f"{found.machine}: {found.count} recordings a protocol, {found.entries} entries")
        draw_reliability(left, found)
        draw_counts(right, found)
    else:
        figure.suptitle(f"{found.machine}, protocol {found.protocol.name}: {found.count} recordings")
        draw_trade(left, found, "wrong")
        draw_trade(right, found, "clearance")
    save(figure, path)


def draw_reliability(axes: Axes, study: Study) -> None:
    """Draw how often the first hypothesis is right over how sure it was, setup by setup."""
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=0.8, label="as sure as right")
    for place, row in enumerate(study.rows):
        bins = [each for each in row.figures.reliability if each.count]
        name = f"{row.protocol.name}, {row.setup.method} {row.setup.effort} {row.setup.mode}"
        axes.plot(
            [each.confidence or 0.0 for each in bins],
            [each.right or 0.0 for each in bins],
            marker="o",
            color=COLOURS[place % len(COLOURS)],
            label=name,
        )
    axes.set_xlabel("probability of the first hypothesis, mean of a bin")
    axes.set_ylabel("share that is right")
    axes.set_xlim(0, 1.02)
    axes.set_ylim(-0.02, 1.02)
    axes.grid(alpha=0.3)
    axes.legend(fontsize="x-small")


def draw_counts(axes: Axes, study: Study) -> None:
    """Draw how many answers lie in each bin of the first probability."""
    for place, row in enumerate(study.rows):
        bins = row.figures.reliability
        axes.step(
            [each.low for each in bins] + [1.0],
            [each.count for each in bins] + [bins[-1].count if bins else 0],
            where="post",
            color=COLOURS[place % len(COLOURS)],
        )
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set_xlabel("probability of the first hypothesis")
    axes.set_ylabel("answers")
    axes.grid(alpha=0.3)


def draw_trade(axes: Axes, sweep: Sweep, what: str) -> None:
    """Draw the share of wrong first hypotheses, or the clearance error, over the cost of the catalogue."""
    lines: dict[tuple[str, str, str, str], list[Point]] = defaultdict(list)
    for point in sweep.points:
        lines[point.accuracy, point.setup.method, point.setup.effort, point.setup.mode].append(point)
    for place, (names, points) in enumerate(lines.items()):
        shown: list[tuple[float, float, int]] = []
        for point in points:
            right = point.figures.top1
            value = point.figures.clearance_median if what == "clearance" else None if right is None else 1.0 - right
            if value is not None:
                shown.append((point.build_seconds, 100.0 * value, point.draws))
        colour = COLOURS[place % len(COLOURS)]
        axes.plot(
            [each[0] for each in shown], [each[1] for each in shown], marker="o", color=colour, label=" ".join(names)
        )
        for cost, value, draws in shown:
            axes.annotate(f"{draws}", (cost, value), textcoords="offset points", xytext=(4, 4), fontsize="x-small")
    axes.set_xscale("log")
    axes.set_xlabel("processor time of the catalogue [s]; at the points: draws a hypothesis")
    axes.set_ylabel("first hypothesis wrong [%]" if what == "wrong" else "clearance error, median [%]")
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize="x-small")
