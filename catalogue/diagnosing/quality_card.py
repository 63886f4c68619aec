"""What the quality card of a catalogue says, and where it is kept."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

from pydantic import Field, ValidationError

from jointplay.catalogue import FEATURES_VERSION, MATCHER_VERSION
from jointplay.catalogue.diagnosing.answer_of_baseline import Frozen

if TYPE_CHECKING:
    from jointplay.catalogue.storage.store import Catalogue

VERSIONS = (FEATURES_VERSION, MATCHER_VERSION)

Share = Annotated[float, Field(ge=0.0, le=1.0)]


class JointQuality(Frozen):
    """What is seen of one joint.

    Attributes
    ----------
    detectable_from_um : float or None
        Smallest radial clearance that 95 % of recordings show, all other joints in order; None where none is.
    seen, called : float or None
        Share of machines in which it is worn, by any amount, whose answers say so; of those whose answers say that it
        is worn, the share in which it is. None of none.
    """

    detectable_from_um: float | None
    seen: Share | None
    called: Share | None


class NoiseQuality(Frozen):
    """Quality at one noise of the sensors.

    Attributes
    ----------
    sensor_noise_m_s2 : float
        Rms up to 5 kHz.
    draws : int
    right : float
        Share of answers whose first hypothesis has exactly the worn joints.
    classes : tuple of str
        "in order", every joint that is worn alone, "several".
    confusion : tuple of tuple of int
        Draws by what is true (rows) and by the first hypothesis (columns), in classes.
    joints : mapping of str to JointQuality
    interval_coverage : float or None
        Share of 90 % intervals that hold the true clearance, of worn joints that are seen; None of none.
    intervals : int
        How many these are.
    """

    sensor_noise_m_s2: float
    draws: int
    right: Share
    classes: tuple[str, ...]
    confusion: tuple[tuple[int, ...], ...]
    joints: dict[str, JointQuality]
    interval_coverage: Share | None
    intervals: int


class QualityCard(Frozen):
    """Quality of the answers of one state of a catalogue, by its own held-out draws.

    Attributes
    ----------
    catalogue : str
        Its id.
    versions : tuple of int
        Of features and matcher.
    revolutions : float
        Length of the recordings.
    noises : tuple of NoiseQuality
    """

    catalogue: str
    versions: tuple[int, int]
    revolutions: float
    noises: tuple[NoiseQuality, ...]


def kept_card(catalogue: Catalogue) -> QualityCard | None:
    """Return the card in a catalogue's folder, if it is of its present state."""
    try:
        kept = QualityCard.model_validate(json.loads(catalogue.layout.quality.read_text(encoding="utf-8")))
    except (OSError, ValueError, ValidationError):
        return None
    return kept if (kept.catalogue, kept.versions) == (catalogue.id, VERSIONS) else None
