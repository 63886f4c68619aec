"""``python -m jointplay.app.openapi_document``: the OpenAPI document, for ``docs/openapi.json``."""

from __future__ import annotations

import json
import sys

from jointplay.app.main import create_app
from jointplay.app.settings import ServiceSettings


def main() -> None:
    """Print it."""
    sys.stdout.write(json.dumps(create_app(ServiceSettings(keys="required")).openapi(), indent=1) + "\n")


if __name__ == "__main__":
    main()
