"""Fields of a form that go with a file, as the OpenAPI document describes them."""

from __future__ import annotations

from typing import Any

from jointplay.app.fields import FILE_FIELDS, PROFILE, FileField


def describe_field(each: FileField) -> dict[str, Any]:
    """Return the description of a field."""
    forms = ' One text for all columns, "a=g, b=mm/s", or a JSON object.' if each.by_column else ""
    values = {"enum": list(each.choices)} if each.choices else {}
    return {"type": "string", **values, "description": f"{each.says}{forms}"}


FILE = {
    "type": "string",
    "format": "binary",
    "description": "A recording or a spectrum: CSV, UFF 58, WAV, MAT, TDMS, HDF5, NPZ, JSON, XLSX, Parquet.",
}
ASSET = {"type": "string", "description": "External id of the machine that was measured; it has to be known."}
SAID: dict[str, Any] = {
    **{each.name: describe_field(each) for each in FILE_FIELDS},
    "profile": {"type": "string", "description": f"{PROFILE} A text, or a small file."},
}
"""What can be said of a file that does not say it itself."""
