"""Libraries of fitted models, one for each catalogue that was used last."""

from __future__ import annotations

import threading
from collections import OrderedDict

from jointplay.catalogue.matching.model_library import ModelLibrary
from jointplay.catalogue.matching.network_shelf import NetworkShelf
from jointplay.catalogue.storage.store import Catalogue

__all__ = ["library_of"]

KEPT = 4
"""Catalogues whose models are kept in memory."""

_known: OrderedDict[tuple[str, str], ModelLibrary] = OrderedDict()
_lock = threading.Lock()


def library_of(catalogue: Catalogue) -> ModelLibrary:
    """Return the library of a catalogue in its present state; the same one for the same state of the same folder."""
    key = (str(catalogue.path), catalogue.id)
    with _lock:
        if key not in _known:
            _known[key] = ModelLibrary(catalogue.matrix, catalogue.layout.models, NetworkShelf.of(catalogue))
        _known.move_to_end(key)
        while len(_known) > KEPT:
            _known.popitem(last=False)
        return _known[key]
