"""What the columns of a feature matrix are: hypotheses, rows, names, checksums; the JSON beside them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Self, get_args

import numpy as np

from jointplay.catalogue.plans.entry import Hypothesis, Stratum, content_digest
from jointplay.catalogue.plans.variants import LawChoice
from jointplay.solver.arrays import BoolArray

STRATA: tuple[Stratum, ...] = get_args(Stratum)
"""In the order of their codes in the column ``stratum``."""

LAWS: tuple[LawChoice, ...] = get_args(LawChoice)
"""In the order of their codes in the column ``law``."""

MATRIX_VERSION = 2
"""Of the files of a matrix; one of another version is made anew."""


class OtherVersionError(ValueError):
    """A matrix that another version of this program wrote; it is made anew."""


@dataclass(frozen=True)
class Ranges:
    """What the entries of a catalogue span.

    Parameters
    ----------
    speed : (float, float)
        Least and greatest drive speed, without its sign [rad/s].
    clearance : mapping of str to (float, float)
        By hypothesis: of the joints that are worn under it [m].
    parameters : mapping of str to (float, float)
        Of the numbers that vary, by path, SI.
    """

    speed: tuple[float, float]
    clearance: Mapping[str, tuple[float, float]]
    parameters: Mapping[str, tuple[float, float]]


@dataclass(frozen=True)
class Guard:
    """How far entries are from the same cases computed more finely.

    Parameters
    ----------
    count : int
        Entries that were computed twice.
    mean_db, p90_db : float
        Mean, and 90th percentile, of their mean differences of band levels [dB].
    """

    count: int
    mean_db: float
    p90_db: float


@dataclass(frozen=True)
class MatrixBlock:
    """Rows of one hypothesis and stratum, one below the other, by number of the draw.

    Parameters
    ----------
    hypothesis : Hypothesis
    stratum : {"trusted", "wide"}
    start, stop : int
        The first row, and the first one after them.
    """

    hypothesis: Hypothesis
    stratum: Stratum
    start: int
    stop: int


@dataclass(frozen=True)
class ColumnFile:
    """Numbers in a file: their type as NumPy writes it, their shape, and the SHA-256 of their bytes."""

    dtype: str
    shape: tuple[int, ...]
    sha256: str


@dataclass(frozen=True)
class MatrixHeader:
    """What the columns are.

    Parameters
    ----------
    id : str
        Of the catalogue, see :attr:`jointplay.catalogue.storage.store.Catalogue.id`.
    content : str
        SHA-256 over all entries with their spectra, however they are divided into shards.
    edges : tuple of float, (B + 1,)
        Edges of the catalogue's bands [orders].
    cuts : tuple of int, (G + 1,)
        Group g of the matrix joins bands cuts[g] to cuts[g + 1] - 1.
    joints : tuple of str
        Turning joints, in alphabetical order: columns of ``clearance``.
    parameter_names : tuple of str
        Paths of the numbers that vary: columns of ``parameters``.
    hypotheses : tuple of Hypothesis
        In the order of their codes in the column ``hypothesis``.
    blocks : tuple of Block
        Of the rows that have a spectrum.
    count, total : int
        Rows that have a spectrum, and all rows; cases that failed stand at the end.
    remarks : mapping of int to (str, str)
        Status and message of the rows where they are not "ok" and nothing.
    files : mapping of str to ColumnFile
        What is in each column's file; empty in memory.
    digests : str
        SHA-256 over the checksums of the blocks of spectra; empty in memory.
    """

    id: str
    content: str
    edges: tuple[float, ...]
    cuts: tuple[int, ...]
    joints: tuple[str, ...]
    parameter_names: tuple[str, ...]
    hypotheses: tuple[Hypothesis, ...]
    blocks: tuple[MatrixBlock, ...]
    count: int
    total: int
    remarks: Mapping[int, tuple[str, str]]
    files: Mapping[str, ColumnFile] = field(default_factory=dict)
    digests: str = ""

    @cached_property
    def worn(self) -> BoolArray:
        """Whether a joint is worn under a hypothesis, (hypotheses, joints)."""
        worn = np.zeros((len(self.hypotheses), len(self.joints)), dtype=np.bool_)
        for code, hypothesis in enumerate(self.hypotheses):
            worn[code, [self.joints.index(joint) for joint in hypothesis.joints]] = True
        return worn

    def to_json(self) -> bytes:
        """Write it, with a checksum of its own."""
        codes = {hypothesis: code for code, hypothesis in enumerate(self.hypotheses)}
        content: dict[str, Any] = {
            "version": MATRIX_VERSION,
            "codes": [list(STRATA), list(LAWS)],
            "id": self.id,
            "content": self.content,
            "edges": list(self.edges),
            "cuts": list(self.cuts),
            "joints": list(self.joints),
            "parameter_names": list(self.parameter_names),
            "hypotheses": [[item.label, list(item.joints)] for item in self.hypotheses],
            "blocks": [[codes[item.hypothesis], item.stratum, item.start, item.stop] for item in self.blocks],
            "count": self.count,
            "total": self.total,
            "remarks": {str(row): list(remark) for row, remark in self.remarks.items()},
            "files": {name: [file.dtype, list(file.shape), file.sha256] for name, file in self.files.items()},
            "digests": self.digests,
        }
        return json.dumps({**content, "checksum": content_digest(content)}).encode()

    @classmethod
    def from_json(cls, text: bytes) -> Self:
        """Read what :meth:`to_json` wrote.

        Raises
        ------
        OtherVersionError
            It is of another version.
        ValueError
            It is damaged.
        """
        content = json.loads(text)
        if not isinstance(content, dict) or content.pop("checksum", None) != content_digest(content):
            raise ValueError("does not match its checksum")
        if content.pop("version") != MATRIX_VERSION or content.pop("codes") != [list(STRATA), list(LAWS)]:
            raise OtherVersionError("is of another version")
        hypotheses = tuple(Hypothesis(label, tuple(joints)) for label, joints in content.pop("hypotheses"))
        blocks = tuple(
            MatrixBlock(hypotheses[code], stratum, start, stop) for code, stratum, start, stop in content.pop("blocks")
        )
        remarks = {int(row): (status, message) for row, (status, message) in content.pop("remarks").items()}
        content["files"] = {
            name: ColumnFile(dtype, tuple(shape), sha256) for name, (dtype, shape, sha256) in content["files"].items()
        }
        content |= {name: tuple(content[name]) for name in ("edges", "cuts", "joints", "parameter_names")}
        return cls(hypotheses=hypotheses, blocks=blocks, remarks=remarks, **content)
