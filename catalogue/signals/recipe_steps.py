"""What was done to a recording: named steps in order, with the numbers they used and what they found.

Nothing heavy is imported here: answers hold such steps, and the command line shows answers.
"""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import BaseModel, ConfigDict

from jointplay.catalogue import FEATURES_VERSION


class RecipeStep(BaseModel):
    """One step from a recording to the levels that are compared.

    Parameters
    ----------
    name : str
        "sensors", "steady part", "disturbances", "drive speed", "hum", "noise floor", "angular resampling", "bands",
        "sensors checked", "gains".
    version : str
        Of all features of the program that took it: raised when any step would do something else.
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


def note_step(name: str, found: str, parameters: Mapping[str, float | str] | None = None) -> RecipeStep:
    """Return a step as this program takes it, see :class:`RecipeStep`."""
    return RecipeStep(name=name, version=str(FEATURES_VERSION), parameters=parameters or {}, found=found)
