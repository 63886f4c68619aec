"""P(worn) of every joint beside a referee: neural posterior estimation by the package sbi, on the same draws.

    pip install sbi
    python -m benchmarks.referee CATALOGUE [--noise 0.03] [--seconds 4]

The referee learns the clearances of all joints from the draws that the product learns from (a neural spline flow behind
an embedding; Greenberg, Nonnenmacher and Macke, ICML 2019; Durkan et al., NeurIPS 2019), and says how likely each is
beyond the play of a fit. Both are judged on the cases that neither has seen, all hypotheses being equally likely.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jointplay.app.tables import table
from jointplay.catalogue.matching.calibration import split_held_out
from jointplay.catalogue.matching.classifier import seen_by_all_sensors
from jointplay.catalogue.matching.learning import Learning, training_set
from jointplay.catalogue.matching.matcher import TrainingSet
from jointplay.catalogue.matching.model_library import Observed, library_of
from jointplay.catalogue.matching.network_shelf import NetworkShelf
from jointplay.catalogue.matching.observation import Sensing
from jointplay.catalogue.storage.store import Catalogue
from jointplay.solver.spectra.bands import FEATURE_ORDERS

FloatArray = NDArray[np.float64]

LEAST_PLAY = 1e-7
"""Clearance [m] that stands for none, which has no logarithm."""

SAMPLES = 1000
"""Of the referee's posterior, for each held-out draw."""


def worn_of(draws: TrainingSet) -> FloatArray:
    """Return which joints are worn (n, joints) in each draw."""
    kinds = np.array([[joint in known.joints for joint in draws.joints] for known in draws.hypotheses], np.float64)
    return np.asarray(kinds[draws.stack()[1]])


def of_product(catalogue: Catalogue, sensing: Sensing, watched: NDArray[np.bool_], held: TrainingSet) -> FloatArray:
    """Return the product's P(worn) (m, joints)."""
    learning = Learning.of("trusted")
    speed = catalogue.matrix.nominal_speed
    networks = NetworkShelf.of(catalogue).every(sensing, learning, speed)
    if networks.hypotheses is None:
        raise SystemExit(f"{catalogue.path}: has no network: build it again, which trains what is missing")
    model = library_of(catalogue).fit(Observed(sensing, np.empty(0), watched, speed), learning, networks)
    prior = np.array([draws.prior for draws in held.hypotheses])
    posterior = model.posterior(held.stack()[0]) / prior
    member = np.array([[joint in known.joints for joint in held.joints] for known in held.hypotheses], np.float64)
    return np.asarray(posterior / posterior.sum(axis=1, keepdims=True) @ member)


def of_referee(catalogue: Catalogue, learned: TrainingSet, held: TrainingSet) -> FloatArray:
    """Return the referee's P(worn) (m, joints)."""
    import torch
    from sbi.inference import NPE
    from sbi.neural_nets import posterior_nn
    from sbi.neural_nets.embedding_nets import FCEmbedding
    from torch.utils.tensorboard import SummaryWriter

    matrix = catalogue.matrix
    columns = [matrix.joints.index(joint) for joint in learned.joints]
    entries = np.concatenate([draws.entry for draws in learned.hypotheses])
    clearance = matrix.clearance(entries)[:, columns]
    least = np.array([clearance[worn > 0.5, j].min() for j, worn in enumerate(worn_of(learned).T)])
    features, seen = learned.stack()[0], held.stack()[0]
    centre, scale = features.mean(axis=0), features.std(axis=0) + 1e-6
    theta = torch.tensor(np.log(np.maximum(clearance, LEAST_PLAY)), dtype=torch.float32)
    x, asked = (torch.tensor((each - centre) / scale, dtype=torch.float32) for each in (features, seen))
    torch.manual_seed(0)
    torch.set_num_threads(1)
    embedding = FCEmbedding(x.shape[1], output_dim=40, num_layers=2, num_hiddens=128)
    with tempfile.TemporaryDirectory() as logs:  # it keeps a log of its training wherever it stands
        inference = NPE(
            density_estimator=posterior_nn("nsf", embedding_net=embedding),
            summary_writer=SummaryWriter(logs),
            show_progress_bars=False,
        )
        flow = inference.append_simulations(theta, x).train(training_batch_size=256)
    with torch.no_grad():
        drawn = [flow.sample((SAMPLES,), condition=part) for part in asked.split(500)]
    beyond = torch.cat([(part.exp() >= torch.tensor(least)).double().mean(dim=0) for part in drawn])
    return np.asarray(beyond.numpy())


def log_loss(p_worn: FloatArray, worn: FloatArray) -> float:
    """Mean of -ln P of what is true of each joint; the referee has no finer probability than its samples allow."""
    likely = np.clip(np.where(worn > 0.5, p_worn, 1.0 - p_worn), 0.5 / SAMPLES, 1.0)
    return float(-np.mean(np.log(likely)))


def main() -> int:
    """Print both log-losses."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("catalogue", type=Path)
    parser.add_argument("--noise", type=float, default=0.03, help="of the sensors, m/s2 rms up to 5 kHz")
    parser.add_argument("--seconds", type=float, default=4.0, help="length of the recordings")
    given = parser.parse_args()
    catalogue = Catalogue.open(given.catalogue)
    sensing = seen_by_all_sensors(catalogue, given.noise, given.seconds)
    low = np.arange(sensing.bands) < FEATURE_ORDERS
    watched = np.repeat(low, len(sensing.channels))
    learning = Learning.of("trusted")
    learned, held = split_held_out(
        training_set(catalogue.matrix, sensing, watched, replace(learning, most=learning.reach, rows=1200))
    )
    worn = worn_of(held)
    answers = (
        ("product", of_product(catalogue, sensing, watched, held)),
        ("sbi, NPE", of_referee(catalogue, learned, held)),
    )
    rows = [(name, f"{log_loss(p_worn, worn):.4f}") for name, p_worn in answers]
    print(table((f"{catalogue.machine.name}, {math.prod(worn.shape)} joints", "log-loss of P(worn)"), rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
