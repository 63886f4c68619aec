"""What was sent, by the rules of its model."""

from __future__ import annotations

from typing import TypeVar

from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ValidationError

Model = TypeVar("Model", bound=BaseModel)


def validate(model: type[Model], sent: object) -> Model:
    """Return what was sent as a model; bytes are a JSON text.

    Raises
    ------
    RequestValidationError
        Answered as the framework's own, where something breaks a rule.
    """
    try:
        return model.model_validate_json(sent) if isinstance(sent, bytes) else model.model_validate(sent)
    except ValidationError as error:
        raise RequestValidationError(error.errors(include_url=False, include_input=False)) from None
