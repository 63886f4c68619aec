"""What ``jointplay evaluate`` prints and draws: figures side by side, reliability, and quality against cost."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from jointplay.app.figures.plots import BLUE, ORANGE, save
from jointplay.app.tables import indent, table
from jointplay.catalogue.evaluation.study import Row, Study
from jointplay.catalogue.evaluation.sweep import Sweep

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from jointplay.catalogue.evaluation.sweep import Sweep, SweepPoint


def report(found: Study | Sweep) -> str:
    """Return the figures as text."""
    if not isinstance(found, Study):
        return sweep_report(found)
    lines = [
        f"{found.machine}, {found.entries} entries; {found.count} recordings a protocol, seed {found.seed}",
        "",
        "which joint:",
        indent(hypotheses_table(found.rows)),
        "",
        "how much, how sure, at what cost:",
        indent(certainty_table(found.rows)),
        "",
        "every joint by itself:",
        indent(joints_table(found.rows)),
        "",
        "what else is said:",
        indent(other_table(found.rows)),
    ]
    foreign = [row for row in found.rows if row.protocol.foreign]
    if foreign:
        lines += ["", "what the catalogue does not hold, beside the same machines without it:"]
        lines.append(indent(foreign_table(foreign)))
    first = found.rows[0].setup
    for row in found.rows:
        if row.setup == first:
            lines += ["", *details(row)]
    return "\n".join(lines)


def hypotheses_table(rows: Sequence[Row]) -> str:
    """Return how often hypotheses and joints are right, row by row."""
    head = (*_SETUP, "first", "first two", "exact joints", "joints in first two", "log-loss", "ECE", "lowest F1")
    cells = []
    for row in rows:
        found = row.figures
        lowest = min((each.f1 for each in found.joints if each.f1 is not None), default=None)
        shares = (found.top1, found.top2, found.exact_set, found.joints_in_top2)
        cells.append(
            (
                *_setup(row),
                *map(percent, shares),
                number(found.log_loss),
                number(found.calibration_error),
                number(lowest),
            )
        )
    return table(head, cells, frozenset(range(len(_SETUP), len(head))))


def certainty_table(rows: Sequence[Row]) -> str:
    """Return clearances, sets, verdicts and times, row by row."""
    head = (
        *_SETUP,
        "clearance p50, p90",
        "in interval",
        "in set, size",
        "unknown",
        "changed",
        "called in order",
        "wrong",
        "time p50, worst",
        "simulated",
    )
    cells = []
    for row in rows:
        found = row.figures
        cells.append(
            (
                *_setup(row),
                f"{percent(found.clearance_median)}, {percent(found.clearance_p90)}",
                percent(found.interval_coverage),
                f"{percent(found.set_coverage)}, {number(found.set_size, 2)}",
                percent(found.unknown),
                percent(found.changed),
                percent(found.in_order),
                percent(found.wrong_verdict),
                f"{seconds(found.seconds_median)}, {seconds(found.seconds_worst)}",
                number(found.simulations, 0),
            )
        )
    return table(head, cells, frozenset(range(len(_SETUP), len(head))))


def joints_table(rows: Sequence[Row]) -> str:
    """Return how true probabilities, clearances and limits of detection of single joints are, row by row."""
    head = (
        *_SETUP,
        "log-loss",
        "not contradicted",
        "open",
        "ranks off by (of)",
        "coverage off by (of)",
        "seen from, limit = 1 (of)",
        '"at least" beyond range',
    )
    cells = []
    for row in rows:
        found = row.figures.joint_posterior
        cells.append(
            (
                *_setup(row),
                number(found.log_loss),
                percent(found.condition_holds),
                percent(found.condition_open),
                f"{number(found.ranks.distance)} ({found.ranks.count})",
                f"{number(found.credibilities.distance)} ({found.credibilities.count})",
                f"{number(found.limit_ratio, 2)} ({found.limits})",
                percent(row.figures.at_least),
            )
        )
    return table(head, cells, frozenset(range(len(_SETUP), len(head))))


def other_table(rows: Sequence[Row]) -> str:
    """Return what is said of causes other than play and of sensors, and what got no answer, row by row."""
    head = (*_SETUP, "cause right", "cause wrong", "sensors right", "sensors wrong", "failed", "refused")
    cells = [
        (
            *_setup(row),
            percent(row.figures.cause_right),
            percent(row.figures.cause_wrong),
            percent(row.figures.sensors_right),
            percent(row.figures.sensors_wrong),
            str(row.failed),
            str(row.refused),
        )
        for row in rows
    ]
    return table(head, cells, frozenset(range(len(_SETUP), len(head))))


def foreign_table(rows: Sequence[Row]) -> str:
    """Return how well p-values tell foreign causes from listed ones, row by row."""
    head = (*_SETUP, "AUROC, deciding p", "AUROC, trusted p", "rejected at 5 % false alarms")
    cells = [
        (
            *_setup(row),
            number(row.figures.auroc_deciding),
            number(row.figures.auroc_trusted),
            percent(row.figures.rejected),
        )
        for row in rows
    ]
    return table(head, cells, frozenset(range(len(_SETUP), len(head))))


def details(row: Row) -> list[str]:
    """Return joint scores, reliability and confusions of one row."""
    found = row.figures
    lost = [f"{row.failed} could not be simulated"] * bool(row.failed) + [f"{row.refused} were refused"] * bool(
        row.refused
    )
    lines = [f"{' '.join(_setup(row))}: {'; '.join([f'{found.count} recordings', *lost])}"]
    lines += [f"  refused {count} times: {reason}" for reason, count in row.reasons.items()]
    if found.hidden:
        lines.append(
            f"  worn joints that never open: {found.hidden} recordings, the same as of machines in order to a tenth of "
            f"their noise; exact joints in the others: {percent(found.exact_of_seen)}"
        )
    losses = found.joint_posterior.log_losses
    scores = [
        (
            *(each.joint, percent(each.precision), percent(each.recall), number(each.f1)),
            number(losses.get(each.joint)),
        )
        for each in found.joints
        if each.f1 is not None
    ]
    if scores:
        lines.append(indent(table(("joint", "precision", "recall", "F1", "log-loss"), scores, frozenset({1, 2, 3, 4}))))
    bins = [
        (f"{each.low:.1f} to {each.high:.1f}", str(each.count), percent(each.confidence), percent(each.right))
        for each in found.reliability
        if each.count
    ]
    if bins:
        lines.append(indent(table(("probability of the first", "count", "mean", "right"), bins, frozenset({1, 2, 3}))))
    lines.append("  truth (rows) against the first hypothesis (columns):")
    cells = [[label, *map(str, counts)] for label, counts in zip(found.labels, found.confusion, strict=True)]
    return [*lines, indent(table(["", *found.columns], cells, frozenset(range(1, len(found.columns) + 1))))]


def sweep_report(found: Sweep) -> str:
    """Return number of draws and accuracy against quality and cost."""
    head = (
        *("accuracy", "draws", "entries", "catalogue", "method", "effort", "mode"),
        *("first", "first two", "log-loss", "clearance p50", "a query"),
    )
    cells = []
    for point in found.points:
        each = point.figures
        cells.append(
            (
                point.accuracy,
                str(point.draws),
                str(point.entries),
                f"{point.build_seconds:.3g} s",
                point.setup.method,
                point.setup.effort,
                point.setup.mode,
                percent(each.top1),
                percent(each.top2),
                number(each.log_loss),
                percent(each.clearance_median),
                seconds(each.seconds_median),
            )
        )
    title = f"{found.machine}, protocol {found.protocol.name}, {found.count} recordings, seed {found.seed}"
    numbers = frozenset((1, 2, 3, *range(7, 12)))
    return f"{title}; catalogue: processor time to build it\n{indent(table(head, cells, numbers))}"


_SETUP = ("protocol", "method", "effort", "mode")


def _setup(row: Row) -> tuple[str, str, str, str]:
    return row.protocol.name, row.setup.method, row.setup.effort, row.setup.mode


def percent(value: float | None) -> str:
    """Return a share in per cent, a dash for none."""
    return "-" if value is None else f"{100 * value:.1f} %"


def number(value: float | None, digits: int = 3) -> str:
    """Return a number, a dash for none."""
    return "-" if value is None else f"{value:.{digits}f}"


def seconds(value: float | None) -> str:
    """Return a time, a dash for none."""
    if value is None:
        return "-"
    return f"{1000 * value:.1f} ms" if value < 0.1 else f"{value:.2f} s"


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
    lines: dict[tuple[str, str, str, str], list[SweepPoint]] = defaultdict(list)
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
