"""``jointplay evaluate``: how good the diagnoses of a catalogue are, on recordings simulated now."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from jointplay.app.commands.parameters import (
    Names,
    QuantityOption,
    existing_catalogue,
    json_option,
    print_json,
    refuse_given,
)
from jointplay.app.commands.progress import ProgressLine
from jointplay.app.figures.machine_account import drive_of
from jointplay.catalogue.building.executors import count_processors
from jointplay.catalogue.errors import DiagnosisError

if TYPE_CHECKING:
    from jointplay.catalogue.evaluation.study import Study
    from jointplay.catalogue.evaluation.sweep import Sweep

PROTOCOLS = (
    "matched, noisy, hard, healthy, pairs, triples, small, beyond-range, cyclic-load, and groups model-error, "
    "other-cause, disturbed, sensor-flaws, drop-outs; lives (machines over thirty visits) by itself"
)

LIVES = "lives"
SWEPT = ("draws", "accuracies", "workers")
"""Options of `--sweep` alone."""


@click.command("evaluate")
@click.option(
    "--catalogue", type=click.Path(path_type=Path), required=True, metavar="DIR", help="Folder of the catalogue."
)
@click.option(
    "--protocol",
    "protocols",
    type=Names(),
    default="hard",
    show_default=True,
    metavar="NAME,...",
    help=f"Kinds of recordings: {PROTOCOLS}; one of a group as model-error-a, other-cause-half-mount, "
    "disturbed-shocks, sensor-flaw-dead, drop-out-short ...",
)
@click.option(
    "--noise",
    type=QuantityOption("ACCELERATION", positive=False),
    metavar='"0.1 m/s2"',
    help="Noise (rms) in place of the protocol's: of the frame in x and y, theta in proportion; of each sensor where "
    "the protocol has it there.",
)
@click.option(
    "--count",
    default=120,
    show_default=True,
    type=click.IntRange(1, 100_000),
    help="Recordings a protocol; of lives: machines.",
)
@click.option("--seed", default=1, show_default=True, type=int, help="Of everything drawn.")
@click.option(
    "--methods",
    type=Names(),
    default="gaussian",
    show_default=True,
    metavar="NAME,...",
    help="Compared on the same recordings: gaussian, cosine, nearest, extra-trees.",
)
@click.option(
    "--efforts",
    "--effort",
    "efforts",
    type=Names(("fast", "standard", "thorough")),
    default="standard",
    show_default=True,
    metavar="fast,standard,thorough",
    help="Efforts of the method gaussian.",
)
@click.option(
    "--modes",
    "--mode",
    "modes",
    type=Names(("auto", "trusted", "robust")),
    default="auto",
    show_default=True,
    metavar="auto,trusted,robust",
    help="How far the model is believed.",
)
@click.option("--sweep", is_flag=True, help="Number of draws and accuracy of the solver against quality and cost.")
@click.option(
    "--draws", type=Names(number=True), default="25,50,100,200,400", show_default=True, help="Draws of --sweep."
)
@click.option(
    "--accuracies",
    type=Names(("draft", "standard", "reference")),
    default="draft,standard",
    show_default=True,
    help="Solver accuracies of --sweep; catalogues that are missing are built.",
)
@click.option(
    "--workers",
    type=click.IntRange(1, 1024),
    default=count_processors,
    help="Processes that build the catalogues of --sweep.",
)
@click.option(
    "--plot", type=click.Path(path_type=Path), metavar="FILE.png|.svg|.pdf", help="Draw reliability, or the sweep."
)
@click.option(
    "--card",
    is_flag=True,
    help="Simulate nothing: the quality card, which a build makes by draws that the catalogue has not learned from.",
)
@json_option
def command(
    catalogue: Path,
    protocols: list[str],
    noise: float | None,
    count: int,
    seed: int,
    methods: list[str],
    efforts: list[Any],
    modes: list[Any],
    sweep: bool,
    draws: list[int],
    accuracies: list[Any],
    workers: int,
    plot: Path | None,
    card: bool,
    as_json: bool,
) -> None:
    """Measure diagnoses on freshly simulated recordings that the catalogue has not seen."""
    if card:
        told = ("protocols", "noise", "count", "seed", "methods", "efforts", "modes", "sweep", "plot", *SWEPT)
        refuse_given(told, "means nothing with --card")
        _show_card(catalogue, as_json)
        return
    if LIVES in protocols:
        if len(protocols) > 1 or sweep:
            raise click.UsageError(f"--protocol: {LIVES}: stands by itself")
        rule = f"means nothing with --protocol {LIVES}, which asks with effort standard"
        refuse_given(("noise", "methods", "efforts", "modes", "plot", *SWEPT), rule)
        _evaluate_lives(catalogue, count, seed, as_json)
        return
    if plot is not None:
        from jointplay.app.figures.plots import check_ending

        check_ending(plot)
    if not sweep:
        refuse_given(SWEPT, "means something with --sweep only")
    elif len(protocols) > 1:
        raise click.UsageError(f"--protocol: {', '.join(protocols)}: --sweep takes one")
    from jointplay.catalogue.evaluation.protocols import protocols_of, with_noise
    from jointplay.catalogue.evaluation.recordings import Recordings
    from jointplay.catalogue.evaluation.study import evaluate, setups_of
    from jointplay.catalogue.storage.store import Catalogue
    from jointplay.solver.compiler.native import cache_directory

    opened = Catalogue.open(existing_catalogue(catalogue))
    setups = setups_of(methods, efforts, modes)
    wanted = protocols_of(protocols)
    if noise is not None:
        wanted = tuple(with_noise(protocol, noise) for protocol in wanted)
    kept = Recordings(cache_directory().parent / "recordings")
    with ProgressLine("diagnosing", "recordings") as line:
        if sweep:
            from jointplay.catalogue.evaluation.sweep import trade_off

            found: Study | Sweep = trade_off(
                opened,
                draws,
                accuracies,
                wanted[0] if len(wanted) == 1 else protocols[0],  # a group is refused by its name
                count,
                seed,
                setups=setups,
                recordings=kept,
                folder=cache_directory().parent / "sweeps",
                workers=workers,
                progress=line.show,
            )
        else:
            found = evaluate(opened, wanted, count, seed, setups=setups, recordings=kept, progress=line.show)
    if plot is not None:
        from jointplay.app.figures.evaluation import plot_evaluation

        plot_evaluation(found, plot)
    if as_json:
        print_json(found.content())
        return
    from jointplay.app.figures.evaluation import report

    click.echo(report(found))
    click.echo(f"\ndrive: {drive_of(opened.machine, opened.recipe.nominal_drive_speed)}")
    if plot is not None:
        click.echo(f"drawn: {plot}")


def _show_card(catalogue: Path, as_json: bool) -> None:
    from jointplay.app.jobs.quality_cards import card_text, made_card

    card, why = made_card(existing_catalogue(catalogue))
    if card is None:
        raise DiagnosisError(f"{catalogue}: no quality card: {why}")
    if as_json:
        print_json(card.model_dump(mode="json"))
    else:
        click.echo(card_text(card))


def _evaluate_lives(catalogue: Path, count: int, seed: int, as_json: bool) -> None:
    from jointplay.app.tables import table
    from jointplay.catalogue.evaluation.lives import VISITS, evaluate_lives
    from jointplay.catalogue.evaluation.recordings import Recordings
    from jointplay.catalogue.storage.store import Catalogue
    from jointplay.solver.compiler.native import cache_directory

    opened = Catalogue.open(existing_catalogue(catalogue))
    kept = Recordings(cache_directory().parent / "recordings")
    with ProgressLine("diagnosing", "recordings") as line:
        found = evaluate_lives(opened, count, seed, recordings=kept, progress=line.show)
    if as_json:
        print_json(found.content())
        return
    click.echo(f"{found.machine}; {count} machines of {VISITS} visits, seed {seed}\n")
    click.echo(table(("figure", "seen", "95 %"), [figure.shown() for figure in found.figures]))
    click.echo(f"\ndrive: {drive_of(opened.machine, opened.recipe.nominal_drive_speed)}")
