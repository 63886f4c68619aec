"""What was done to a recording: named steps in order, with the numbers they used and what they found."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import BaseModel, ConfigDict

__all__ = ["RecipeStep"]


class RecipeStep(BaseModel):
    """One step from a recording to the levels that are compared.

    Parameters
    ----------
    name : str
        "sensors", "steady part", "disturbances", "drive speed", "hum", "noise floor", "angular resampling", "bands",
        "sensors checked", "gains".
    version : str
        Raised when the step would do something else with the same recording.
    parameters : mapping of str to number or str
        Settings of the step, SI.
    found : str
        What it found in this recording, one line.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    name: str
    version: str
    parameters: Mapping[str, float | str]
    found: str

    def __str__(self) -> str:
        """Return name and finding in one line."""
        return f"{self.name}: {self.found}"
