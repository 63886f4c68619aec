"""The page of results: Markdown and plots from the kept figures."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.comparison import LIMIT_DB
from benchmarks.plots import draw
from benchmarks.programs import OURS

_HEAD = """# Benchmarks

Written by `make bench`; every figure and plot comes from `benchmarks/results.json`. Processor seconds, one core,
one process at a time. Noise: other work on a machine only ever adds processor time, so the least of several rounds
counts, and the rounds of a comparison go through all programs in turn. A run of more than 2 s is made once."""

_SAME = """\
Harmonic error is the mean |dB| of the frame's y acceleration at the first 200 multiples of the drive's frequency,
those below 2 kHz, after the transient. Every program runs from its loosest setting until it meets {limit:g} dB. The
cost is that of the first setting that does, or what lies on the straight line (logarithms of cost and error) to the
one before at {limit:g} dB. `s/s` are processor seconds per simulated second. All record
instantaneous values at 20 kHz, but ours, which makes what its spectra are made of: accelerations at 10 kHz, free of
aliases and flat to 4 kHz; a row of ours at 20 kHz, with displacements and velocities, is there, too."""

_P1 = """\
Slider-crank on a sprung frame, 0.2 mm between rod and slider, 600 rpm, 2 s, transient 0.5 s. The reference is an
independent program's (tests/data/reference). Ours takes sixteen equal cases on one core, as in a table of cases;
what one case alone takes is a row of its own. The integrators of SciPy and CVODE work on a right-hand side of this
one machine that was derived by hand, in minimal coordinates, compiled by Numba (`benchmarks/slider_crank.py`), with
steps of at most a 120th of a revolution. MuJoCo and Exudyn have their own models of the machine with the same
contact law: in MuJoCo as compiled code, in Exudyn as one of its symbolic user functions, which run without Python."""

_QR = """\
Shipped quick-return, 0.2 mm at the rocker's pivot, 120 rpm, 4 s, transient 2 s. The reference is our own run at a
tolerance of 1e-11; CVODE on the same equations at 1e-12 is {confirmed} dB from it, and Exudyn, with equations of its
own, as near as the table says. SciPy and CVODE integrate the product's own equations, printed as scalar code: of
them, the integrators are compared, not the models."""


def _number(value: float | None, digits: int = 3) -> str:
    return "" if value is None else f"{value:.{digits}g}"


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows), ""]


def _comparison(curves: list[dict[str, Any]]) -> list[str]:
    """One row a program; those that could not be run are named."""
    ours = next(curve["cost"] for curve in curves if curve["program"] == OURS)
    rows = []
    for curve in curves:
        if curve["cost"] is None:
            rows.append([curve["program"], curve["missing"], "", "", ""])
            continue
        ratio = curve["cost"] / ours if ours else None
        setting = f"{curve['setting']:g}{curve['unit']}"
        rows.append([curve["program"], setting, _number(curve["error"], 2), _number(curve["cost"]), _number(ratio)])
    head = ["program", "setting that meets it", "its error, dB", f"s/s at {LIMIT_DB:g} dB", "ratio to ours"]
    return _table(head, rows)


def _computer(computer: dict[str, Any]) -> list[str]:
    versions = ", ".join(f"{name} {version or 'missing'}" for name, version in computer["versions"].items())
    return [
        f"Measured {computer['date']} on {computer['processor']} ({computer['architecture']}), "
        f"{computer['cores']} cores, {computer['system']}; load average at the start {computer['load'][0]:g}. "
        f"{versions}.",
        "",
    ]


def _throughput(found: dict[str, Any]) -> list[str]:
    return [
        f"{found['cases']} cases of P1, 2 s each, clearances from 0.02 to 1 mm, tolerance {found['tolerance']:g}, "
        f"one core: **{found['per_second']:.0f} cases per second**, {found['failed']} failed; "
        f"{100 * found['integrating']:.0f} % of the time is integration with its records, the rest prepares and "
        f"filters. Harmonic error of eight of them against a tolerance of 1e-9: median {found['error_median']:.2g} dB, "
        f"worst {found['error_worst']:.2g} dB. "
        f"Lanes busy: {100 * found['busy']:.1f} % (from the accepted steps of every case, each lane taking the next "
        f"case when its own has ended).",
        "",
    ]


def _arithmetic(found: dict[str, Any]) -> list[str]:
    rows = []
    for row in found["rows"]:
        kinds = row["instructions"]
        rows.append([
            row["scene"], *(str(row[key]) for key in ("coordinates", "symbols", "operations", "flops")),
            f"{kinds['all']} ({kinds['arithmetic']} arithmetic, {kinds['divisions and roots']} divisions and roots)",
            f"{row['ns']:.1f}", f"{row['gflops']:.1f}", f"{100 * row['share']:.0f} %",
        ])  # fmt: skip
    head = ["", "coordinates", "CasADi's instructions", "vector operations", "flops", "machine instructions, 8 lanes",
            "ns a lane", "Gflop/s", "of the peak"]  # fmt: skip
    return [
        *_table(head, rows),
        f"The peak is that of independent fused multiplications and additions on rows in registers, measured: "
        f"{found['peak_gflops']:.0f} Gflop/s. A fused multiplication and addition counts as two flops, all else, "
        f"divisions and roots too, as one. Machine instructions are counted in the compiler's output. "
        f"P1 by hand, scalar: {found['by_hand_ns']:.0f} ns.",
        "",
    ]


def _links(rows: list[dict[str, Any]]) -> list[str]:
    table = [
        [str(r["moving"]), str(r["unknowns"]), str(r["symbols"]), str(r["operations"]), f"{r['equations_s']:.2f}",
         f"{r['compile_s']:.2f}", f"{r['ns']:.0f}", f"{1e6 * r['dense_ms'] / r['ns']:.0f}"]
        for r in rows
    ]  # fmt: skip
    head = ["moving links", "3N + 2J", "instructions of CasADi", "vector operations", "equations, s", "compilation, s",
            "ns a lane", "dense NumPy solution, times ours"]  # fmt: skip
    by = {r["moving"]: r for r in rows}
    text = ""
    if 41 in by and 81 in by:
        ratio, time = (by[81][key] / by[41][key] for key in ("operations", "ns"))
        text = f" From 41 to 81 links: {ratio:.2f} times the operations, {time:.2f} times the time."
    return [*_table(head, table), f"Chains of four-bar loops on one sprung frame, all joints ideal.{text}", ""]


def _clearances(rows: list[dict[str, Any]]) -> list[str]:
    table = [
        [
            r["machine"],
            str(r["open"]),
            str(r["coordinates"]),
            str(r["operations"]),
            f"{r['ns']:.1f}",
            f"{r['cost']:.4f}",
        ]
        for r in rows
    ]
    return _table(
        ["machine", "open at once", "coordinates", "vector operations", "ns a lane", "s/s at `standard`"], table
    )


def _compilation(rows: list[dict[str, Any]]) -> list[str]:
    table = [
        [r["scene"], r["cache"], *(f"{r[k]:.2f}" for k in ("import_s", "other_s", "first_s")), f"{r['peak_mb']:.0f}"]
        for r in rows
    ]
    head = ["", "caches", "import, s", "another machine first, s", "then this one, s", "peak memory, MB"]
    return [
        *_table(head, table),
        "Processor time of new processes; runs of 0.01 s, from the equations on. With empty caches the first also",
        "compiles the integrators, once for all machines. Peak memory after eight cases, or as many as named.",
        "",
    ]


def _loading(rows: list[dict[str, Any]]) -> list[str]:
    return _table(
        ["machine file", "YAML, ms", "all, ms"], [[r["machine"], f"{r['read']:.1f}", f"{r['all']:.1f}"] for r in rows]
    )


def lines(results: dict[str, Any]) -> list[str]:
    """The page."""
    out = [_HEAD, ""]
    found = {name: section["found"] for name, section in results.items()}
    if results:
        out += _computer(max((s["computer"] for s in results.values()), key=lambda c: str(c["date"])))
    if "p1" in found or "qr" in found:
        out += ["## Cost at equal harmonic error", "", _SAME.format(limit=LIMIT_DB), ""]
    if "p1" in found:
        out += ["### P1", "", _P1, "", *_comparison(found["p1"]), "![P1](benchmarks/p1.svg)", ""]
    if "qr" in found:
        text = _QR.format(confirmed=_number(found["qr"]["confirmed"], 2))
        out += ["### QR", "", text, "", *_comparison(found["qr"]["curves"]), "![QR](benchmarks/qr.svg)", ""]
    for name, title, render in (
        ("throughput", "Throughput", _throughput),
        ("arithmetic", "One right-hand side", _arithmetic),
        ("links", "Cost against links", _links),
        ("clearances", "Cost against clearances open at once", _clearances),
        ("compilation", "Compilation, cache, memory", _compilation),
        ("loading", "Reading a machine file", _loading),
    ):
        if name in found:
            out += [f"## {title}", "", *render(found[name])]
            if name in ("links", "clearances"):
                out += [f"![{title}](benchmarks/{name}.svg)", ""]
    return out


def write(results: dict[str, Any], folder: Path) -> None:
    """Page and plots into a folder."""
    (folder / "benchmarks.md").write_text("\n".join(map(_wrapped, lines(results))).rstrip() + "\n")
    draw({name: section["found"] for name, section in results.items()}, folder / "benchmarks")


def _wrapped(line: str) -> str:
    """A line of prose in lines of 120 columns; what is a table, or wrapped already, stays as it is."""
    if "\n" in line or len(line) <= 120 or line.startswith("|"):
        return line
    return textwrap.fill(line, 120, break_long_words=False, break_on_hyphens=False)
