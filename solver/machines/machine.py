"""A machine: links, joints, drive, supports, loads and sensors, read from one file and checked.

Everything is in SI and in the global coordinates of one drawing; see ``docs/reference/machine-file.md``.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from functools import cached_property, lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar, cast

from pydantic import ValidationError, ValidationInfo, model_validator

from jointplay.solver.errors import MachineError
from jointplay.solver.machines import rules
from jointplay.solver.machines.content import MachineContent
from jointplay.solver.machines.fields import nearest
from jointplay.solver.machines.joints import SlidingJoint, TurningJoint
from jointplay.solver.machines.matrix import read_matrix_form
from jointplay.solver.machines.parts import ForceDrive, Sensor, Spring, Support, TorqueDrive
from jointplay.solver.machines.refusals import first_error
from jointplay.solver.machines.response import with_response
from jointplay.solver.machines.yamlfile import read_text, read_tree


class Machine(MachineContent):
    """A planar machine in its drawn pose, all clearances closed.

    ``gravity`` [m/s2] acts in -y. ``frame`` names the link that carries the sensors; the first link unless said.
    What may be left out of a file is filled in here: the frame, each joint's pin and contact, free lengths.
    """

    @model_validator(mode="before")
    @classmethod
    def _refuse_units_of_another_law(cls, data: Any) -> Any:
        rules.refuse_units_of_another_law(data)
        return data

    @model_validator(mode="after")
    def _complete(self, info: ValidationInfo) -> Machine:
        fill = self.__dict__.update  # the model is frozen for everybody else
        fill(frame=self.frame or next(iter(self.links), ""))
        fill(joints={name: self._complete_joint(joint) for name, joint in self.joints.items()})
        rules.check(self, (info.context or {}).get("source", "machine"))
        fill(supports=tuple(map(_complete_support, self.supports)))
        if self.response is not None:
            fill(decoupled=True)
        return self

    def _complete_joint(self, joint: TurningJoint | SlidingJoint) -> TurningJoint | SlidingJoint:
        contact = joint.contact.over(self.defaults.contact)
        if isinstance(joint, SlidingJoint):
            return joint if joint.length is None else joint.model_copy(update={"contact": contact})
        return joint.model_copy(update={"pin": joint.pin or joint.links[0], "contact": contact})

    def canonical_json(self) -> str:
        """Return the whole machine as JSON, the same text for the same content: sorted keys, shortest exact numbers."""
        return json.dumps(self.model_dump(), sort_keys=True, separators=(",", ":"), allow_nan=False)

    @cached_property
    def content_key(self) -> str:
        """SHA-256 of :meth:`canonical_json`, in hexadecimal."""
        return hashlib.sha256(self.canonical_json().encode()).hexdigest()

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Machine:
        """A copy with some fields changed, and a content key of its own."""
        copy = super().model_copy(update=update, deep=deep)
        copy.__dict__.pop("content_key", None)
        return copy

    def without_clearances(self) -> Machine:
        """The machine alone, as catalogues hold it: without the clearances that its file gives to joints."""
        if not self.clearances:
            return self
        closed = {name: self.joints[name].model_copy(update={"clearance": None}) for name in self.clearances}
        return self.model_copy(update={"joints": {**self.joints, **closed}})

    def __hash__(self) -> int:
        return hash(self.content_key)


def has_known_effort(machine: Machine) -> bool:
    """Whether torque or force of the drive are given, and its motion is not."""
    return isinstance(machine.drive, TorqueDrive | ForceDrive)


def _complete_support(support: Support) -> Support:
    if not isinstance(support, Spring) or support.free_length is not None:
        return support
    free_length = math.dist(support.at, support.anchor) + (support.static_deflection or 0.0)
    return support.model_copy(update={"free_length": free_length, "static_deflection": None})


def parse_machine(content: str | Mapping[str, object], source: str = "machine", folder: Path | None = None) -> Machine:
    """Read a machine from text or from a tree that was read already.

    Parameters
    ----------
    content : str or mapping
        YAML 1.2 or JSON, or the mapping it stands for; a mechanism matrix with its data is a machine too.
    source : str
        What messages call it: a file's name.
    folder : Path, optional
        Where the file of a frequency response is looked for; without it, a machine has its numbers in it.

    Returns
    -------
    Machine
        Complete and checked. Whether it can be assembled and driven is for :mod:`jointplay.solver.cases.start` to
        say.

    Raises
    ------
    MachineError
        For the first thing that is wrong: file, dotted path, value, rule in one line.
    """
    tree = read_tree(content, source) if isinstance(content, str) else dict(content)

    def placed(bare: dict[str, object]) -> tuple[tuple[Sensor, ...], tuple[float, float]]:
        machine = parse_machine(bare, source)
        return machine.sensors, machine.links[machine.frame].cg

    tree = with_response(tree, source, folder, placed)
    form = read_matrix_form(tree, source) if "matrix" in tree else None
    if form is not None:
        tree = form.tree
    try:
        machine = Machine.model_validate(tree, context={"source": source})
    except ValidationError as error:
        raise first_error(error, tree, source) from None
    if form is not None:
        form.check_supports(machine, source)
    return machine


def _find_shipped() -> dict[str, Any]:
    folder = resources.files("jointplay.solver.machines") / "shipped"
    return {file.name.removesuffix(".yaml"): file for file in folder.iterdir() if file.name.endswith(".yaml")}


def shipped_machine_names() -> tuple[str, ...]:
    """Names of the machines that come with the program, sorted."""
    return tuple(sorted(_find_shipped()))


def shipped_machine_text(name: str) -> str:
    """Return a shipped machine as the text of its file.

    Raises
    ------
    MachineError
        When there is none of that name.
    """
    files = _find_shipped()
    if name not in files:
        raise MachineError("", "", name, f"is not a shipped machine{nearest(name, sorted(files))}")
    return str(files[name].read_text(encoding="utf-8"))


@lru_cache(maxsize=32)
def shipped_machine(name: str) -> Machine:
    """Read a shipped machine.

    Raises
    ------
    MachineError
        When there is none of that name.
    """
    return parse_machine(shipped_machine_text(name), f"{name}.yaml")


def load_machine(name_or_path: str | Path) -> Machine:
    """Read a shipped machine by its name, or a machine file (YAML or JSON) by its path; an existing file wins.

    Raises
    ------
    MachineError
        When it is neither, when the file cannot be read, or as :func:`parse_machine`.
    """
    names, name = shipped_machine_names(), str(name_or_path)
    if name in names and not Path(name).is_file():
        return shipped_machine(name)
    return parse_machine(machine_text(name), name, Path(name).parent)


def machine_text(name: str) -> str:
    """Text of a shipped machine, or of a machine file by its path; an existing file wins.

    Raises
    ------
    MachineError
        When it is neither, or when the file cannot be read.
    """
    names = shipped_machine_names()
    shipped = name in names and not Path(name).is_file()
    return shipped_machine_text(name) if shipped else read_text(name, "machine", names)


def machine_json_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a machine file."""
    schema = Machine.model_json_schema(mode="validation")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "jointplay machine file"}


Function = TypeVar("Function", bound=Callable[..., Any])


def keep_by_machine(most: int) -> Callable[[Function], Function]:
    """Keep the last `most` results of a function of a machine and of other things that can be hashed.

    Machines of the same content are equal in whatever order their files name links and joints, but equations written in
    another order round otherwise. What is kept must not depend on which of them a process met first.
    """

    def decorated(function: Function) -> Function:
        @lru_cache(maxsize=most)
        def of(order: tuple[tuple[str, ...], ...], machine: Machine, *others: Any) -> Any:
            return function(machine, *others)

        def found(machine: Machine, *others: Any) -> Any:
            return of((tuple(machine.links), tuple(machine.joints)), machine, *others)

        found.__doc__ = function.__doc__
        return cast(Function, found)

    return decorated
