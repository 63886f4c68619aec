"""What must be true of the numbers in a shard."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jointplay.catalogue.errors import CatalogueError, CatalogueFileError
from jointplay.catalogue.plans.entry import Entry
from jointplay.catalogue.plans.keys import entry_key
from jointplay.catalogue.storage.cross_power import CYCLIC, pack, unpack
from jointplay.catalogue.storage.feature_bands import FEATURE_ORDERS
from jointplay.catalogue.storage.shard import OK, Shard
from jointplay.solver.errors import MachineError
from jointplay.solver.machines.machine import parse_machine


def check_shard(shard: Shard, path: Path) -> None:
    """Refuse a shard whose numbers cannot be, whatever its checksum says.

    Parameters
    ----------
    shard : Shard
    path : Path
        Its file, for messages.

    Raises
    ------
    CatalogueFileError
        Says what is wrong.
    """
    count, spectra = shard.count, shard.power.shape[0]
    bands = shard.header.recipe.scheme.count
    if shard.power.shape != (spectra, bands, 9) or shard.spread_db.shape != (spectra, bands, 3):
        raise CatalogueFileError(path, "has spectra of another shape than its bands ask for")
    groups = len(shard.header.recipe.scheme.third_octave_groups(FEATURE_ORDERS)) - 1
    if shard.cyclic.shape != (spectra, groups, len(CYCLIC)):
        raise CatalogueFileError(path, "has cyclic powers of another shape than its bands ask for")
    columns = ("status", "message", "clearance", "parameters", "draw", "segments", "row", "drive_speed")
    if any(len(getattr(shard, column)) != count for column in (*columns, "transient", "guard_db")):
        raise CatalogueFileError(path, "has columns of different lengths")
    if not (np.isfinite(shard.power).all() and np.isfinite(shard.spread_db).all() and (shard.spread_db >= 0).all()):
        raise CatalogueFileError(path, "holds a number that is not finite, or a negative spread")
    if not np.isfinite(shard.cyclic).all():
        raise CatalogueFileError(path, "holds a cyclic power that is not finite")
    if not (shard.power[..., :3] >= 0).all():
        raise CatalogueFileError(path, "holds a negative power")
    if not np.array_equal(pack(unpack(shard.power)), shard.power):
        raise CatalogueFileError(path, "holds cross-powers that do not read back")
    good = np.array([status == OK for status in shard.status], dtype=bool)
    if not np.array_equal(np.sort(shard.row[good]), np.arange(spectra)) or (shard.row[~good] != -1).any():
        raise CatalogueFileError(path, "has entries whose spectrum is missing")
    _check_keys(shard, path)


def _check_keys(shard: Shard, path: Path) -> None:
    """Make every key again from what it stands for."""
    try:
        machine = parse_machine(shard.header.machine, str(path))
        for position in range(shard.count):
            entry: Entry = shard.entry(position)
            content = shard.header.recipe.content
            version, variant = shard.header.numbers_version, entry.variant.content
            key = entry_key(machine.content_key, entry.fault, entry.parameters, content, version, variant)
            if key != entry.key:
                raise CatalogueFileError(path, f"entry {entry.key[:12]} does not match its key")
    except MachineError as error:
        raise CatalogueFileError(path, f"has a machine that cannot be read ({error.rule})") from None
    except CatalogueFileError:
        raise
    except CatalogueError as error:
        raise CatalogueFileError(path, f"holds a number that is not finite ({error})") from None
