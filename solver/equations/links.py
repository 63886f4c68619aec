"""Motion of every link and every reaction, from the recorded motion of a reduced model.

The reduced model has eliminated most reactions. The expanded one, same equations with nothing eliminated, has them all
as multipliers of its closures; it is evaluated at the recorded states.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.equations.geometry import Complex
from jointplay.solver.equations.model import Model, build_model
from jointplay.solver.equations.numbers import contact_paths
from jointplay.solver.machines.machine import Machine, keep_by_machine

MOTIONS = ("x", "y", "theta")


@dataclass(frozen=True, eq=False)
class LinkMotion:
    """What every link does and what the joints carry.

    Attributes
    ----------
    links : tuple of str
    displacement, velocity, acceleration : (n, links, 3) arrays
        x, y (m ...) and theta (rad ...) of the centres of gravity from the drawn pose, global axes.
    reactions : dict of str to array
        By name: ``force_J`` (n, 2) on links[0] of turning joint J, N, global axes; ``force_J_on_pin`` (n, 2) for one
        with clearance; ``normal_J`` and ``couple_J`` (n,) on links[0] of a sliding joint, N and N m, the normal being
        the direction turned by +90 deg (with clearance the sum over the corners, and the moment of all their forces
        about the joint's point); ``drive_effort`` (n,) of a prescribed drive, on links[0] or its
        link, N m or N.
    open : tuple of str
        Those of joints that hold together more than there is to hold: their sum has a value, their shares have none.
        Joints that repeat another have 0 here; the others share by least squares.
    """

    links: tuple[str, ...]
    displacement: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    reactions: dict[str, FloatArray]
    open: tuple[str, ...] = ()


@keep_by_machine(16)
def expand(machine: Machine, joints: tuple[str, ...], varying: tuple[str, ...]) -> Model:
    """The model in which nothing is eliminated, see :func:`jointplay.solver.equations.kinematics.kinematics`."""
    return build_model(machine, joints, varying, expanded=True)


def _link_state(reduced: Model) -> tuple[ca.SX, ca.SX]:
    """Displacements from the drawn pose and velocities of all links, then of the frame's modes, (3N + m, 1)."""
    kin, names = reduced.kinematics, reduced.machine.links
    pose = ca.vertcat(*map(kin.placed, names))
    pose = ca.vertcat(pose, kin.z[kin.modes]) if kin.modes else pose
    drawn = ca.vertcat(*(ca.DM([*link.cg, 0.0]) for link in names.values()), ca.DM.zeros(len(kin.modes)))
    return pose - drawn, ca.jtimes(pose, reduced.z, reduced.v) + ca.jacobian(pose, reduced.t)


def _places(full: Model) -> list[int]:
    """Where the coordinates of the expanded model are among x, y, theta of all links and modes of the frame."""
    names = list(full.machine.links)
    places = {f"{motion}({name})": 3 * i + k for i, name in enumerate(names) for k, motion in enumerate(MOTIONS)}
    places |= {full.kinematics.names[i]: 3 * len(names) + k for k, i in enumerate(full.kinematics.modes)}
    return [places[name] for name in full.kinematics.names]


def expanded_state(reduced: Model, full: Model) -> ca.Function:
    """(t, z, v, p) of the reduced model -> coordinates and velocities of the expanded one."""
    places = _places(full)
    return reduced.function("expanded_state", *(part[places] for part in _link_state(reduced)))


def _names(model: Model) -> list[str]:
    """Name of every column that :func:`_evaluation` puts out."""
    columns = [_name(closure) for closure in model.repeats.all]
    for joint in model.clearance_joints:
        guide = joint in model.machine.sliding_joints
        columns += [f"normal_{joint}", f"couple_{joint}"] if guide else [f"force_{joint}_on_pin"] * 2
    return columns


def _name(closure: str) -> str:
    """Name of the reaction that a closure has."""
    joint, _, kind = closure.partition(".")
    return {"x": f"force_{joint}", "y": f"force_{joint}", "drive": "drive_effort"}.get(kind, f"{kind}_{joint}")


def _evaluation(reduced: Model, full: Model) -> ca.Function:
    """(t, z, v, p, memory of the reduced model) -> pose, velocity, acceleration of links; reactions in global axes."""
    displacement, velocity = _link_state(reduced)
    acceleration = (
        ca.mtimes(ca.jacobian(displacement, reduced.z), reduced.acceleration)
        + ca.jtimes(velocity, reduced.z, reduced.v)
        + ca.jacobian(velocity, reduced.t)
    )
    # Coordinates of the expanded model are displacements of links: x(link), y(link), theta(link).
    places = _places(full)
    arguments = [reduced.t, displacement[places], velocity[places], reduced.p]
    terms = full.kinematics.terms
    forces: list[ca.SX] = []
    kept = {closure.name: row for row, closure in enumerate(full.kinematics.closures)}
    every = ca.vertcat(*(full.reactions[kept[name]] if name in kept else 0 for name in full.repeats.all))
    for row, name in enumerate(full.repeats.all):
        kind = name.partition(".")[2]
        if kind == "x":
            forces.append(terms.to_ground(_pair(every, row)).column)
        elif kind != "y":
            forces.append(every[row])
    for name, push in full.push.items():
        forces.append(push if name in full.machine.sliding_joints else terms.to_ground(_pair(push, 0)).column)
    reactions = full.function_of_memory("reactions", ca.vertcat(*forces) if forces else ca.SX(0, 1))(
        *arguments, reduced.memory
    )
    of_links = (part[: 3 * len(full.machine.links)] for part in (displacement, velocity, acceleration))
    return reduced.function_of_memory("links", *of_links, reactions)


def _pair(vector: ca.SX, row: int) -> Complex:
    return Complex(vector[row], vector[row + 1])


def link_motion(
    reduced: Model, p: list[float], t: FloatArray, z: FloatArray, v: FloatArray, memory: FloatArray | None = None
) -> LinkMotion:
    """Evaluate links and reactions at recorded states.

    Parameters
    ----------
    reduced : Model
    p : list of float
        Its lane parameters.
    t : (n,) array
    z, v : (n, k) arrays
        Recorded coordinates and velocities.
    memory : (n, m) array, optional
        What contacts remember; nothing by default: contacts count as beginning at every state.
    """
    contact = {path for joint in reduced.clearance_joints for path in contact_paths(reduced.machine, joint)}
    varying = tuple(path for path in reduced.parameters if path not in contact and path != "drive.speed")
    full = expand(reduced.machine, reduced.clearance_joints, varying)
    count = len(t)
    if count == 0:  # a case that failed at once: shapes are all there is
        t, z, v = np.zeros(1), np.zeros((1, reduced.size)), np.zeros((1, reduced.size))
    evaluate = _evaluation(reduced, full).map(len(t))
    if memory is None or count == 0:
        memory = np.zeros((len(t), reduced.memory.shape[0]))
    columns = np.repeat(np.array(p).reshape(-1, 1), len(t), axis=1)
    parts = [np.asarray(part.full()).T[:count] for part in evaluate(t[None, :], z.T, v.T, columns, memory.T)]
    names = tuple(reduced.machine.links)
    motion = [part.reshape(count, len(names), 3) for part in parts[:3]]
    reactions: dict[str, FloatArray] = {}
    for name, column in zip(_names(full), parts[3].T, strict=True):
        reactions[name] = np.column_stack([reactions[name], column]) if name in reactions else column
    unsettled = tuple(dict.fromkeys(map(_name, full.repeats.open)))
    return LinkMotion(names, motion[0], motion[1], motion[2], reactions, unsettled)
