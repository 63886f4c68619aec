"""The frame on its supports as a rigid body: what a force makes of it, and what other numbers would have made."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from jointplay.catalogue.signals.prepared import PreparedMeasurement
from jointplay.catalogue.signals.recipe_steps import note_step
from jointplay.catalogue.signals.sensors import MOTIONS, free_motions
from jointplay.solver.arrays import AnyComplexArray, ComplexArray, FloatArray
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import Mount
from jointplay.solver.spectra.band_power import CYCLES, transform_power
from jointplay.solver.spectra.bands import FEATURE_ORDERS


def accelerance(machine: Machine, parameters: Mapping[str, float], frequency: FloatArray) -> ComplexArray:
    """Acceleration of the frame [x, y, theta] for a unit force and moment at its centre of gravity.

    Parameters
    ----------
    machine : Machine
        Its frame supported by mounts to the ground only, see :func:`on_mounts`; other supports are left out.
    parameters : mapping of str to float
        Numbers that differ from the machine file, by path.
    frequency : (B,) array
        Hz, > 0.

    Returns
    -------
    (B, 3, 3) complex array
        -w^2 (-w^2 M + i w C + K)^-1 of the motions that the frame is free to make, zeros for others.
        The links' mass moves with the frame in x and y, on average.
    """
    frame = machine.frame
    body = machine.links[frame]
    mass = parameters.get(f"links.{frame}.mass", body.mass or 0.0)
    inertia = parameters.get(f"links.{frame}.inertia", body.inertia or 0.0)
    carried = sum(link.mass or 0.0 for name, link in machine.links.items() if name != frame)
    stiffness, damping = np.zeros((3, 3)), np.zeros((3, 3))
    for index, support in enumerate(machine.supports):
        if not isinstance(support, Mount) or support.link != frame or support.to_link is not None:
            continue
        x, y = support.at[0] - body.cg[0], support.at[1] - body.cg[1]
        lever = np.array([[1.0, 0.0, -y], [0.0, 1.0, x]])
        for matrix, name, own in ((stiffness, "stiffness", support.stiffness), (damping, "damping", support.damping)):
            path = f"supports.{index}.{name}"
            values = [parameters.get(f"{path}.{axis}", value) for axis, value in enumerate(own)]
            matrix += lever.T @ np.diag(values) @ lever
    circular = 2.0 * math.pi * np.asarray(frequency, dtype=np.float64)[:, None, None]
    inertial = np.diag([mass + carried, mass + carried, inertia])
    dynamic = -(circular**2) * inertial + 1j * circular * damping + stiffness
    free = np.zeros((3, 3))
    free[np.ix_(free_motions(machine), free_motions(machine))] = 1.0
    return np.asarray(-(circular**2) * inverse_of(np.asarray(dynamic * free, np.complex128)), dtype=np.complex128)


def inverse_of(matrices: AnyComplexArray) -> ComplexArray:
    """Return the inverses of matrices (..., 3, 3) between motions that are free: zeros where all have zeros."""
    free = np.flatnonzero(np.abs(matrices).reshape(-1, 3).any(axis=0))
    found = np.zeros(matrices.shape, dtype=np.complex128)
    found[..., free[:, None], free] = np.linalg.inv(matrices[..., free[:, None], free])
    return found


def on_mounts(machine: Machine) -> bool:
    """Whether mounts to the ground are all that holds the frame, so that :func:`accelerance` knows its supports.

    A frame that answers by a measured response does not follow the file's mounts.
    """
    frame = machine.frame
    return machine.response is None and all(
        isinstance(support, Mount) and support.link == frame and support.to_link is None
        for support in machine.supports
        if frame in (support.link, support.to_link)
    )


def suspension_change(machine: Machine, parameters: Mapping[str, float], frequency: FloatArray) -> ComplexArray:
    """What turns the free motions of a machine with other numbers into those of the machine file, (B, 3, 3).

    The forces of the links on the frame are taken to be the same, which they are as long as the frame moves little.
    """
    file, other = accelerance(machine, {}, frequency), accelerance(machine, parameters, frequency)
    return np.asarray(file @ inverse_of(other), dtype=np.complex128)


def with_filed_suspension(
    prepared: PreparedMeasurement, machine: Machine, parameters: Mapping[str, float]
) -> PreparedMeasurement:
    """Return a recording as a machine with the frame and supports of its file would have made it.

    Parameters
    ----------
    prepared : PreparedMeasurement
    machine : Machine
    parameters : mapping of str to float
        Numbers of frame and supports as they are, by path.

    Returns
    -------
    PreparedMeasurement
        The recording itself where its sensors do not see x, y and theta of the frame (one of them alone cannot be
        converted), or where the frame stands on more than mounts to the ground. What sensors contradict each other by
        is lost.
    """
    sensing = prepared.sensing
    if sensing.compared != MOTIONS or not on_mounts(machine):
        return prepared
    speed, bands = prepared.drive_speed, prepared.sensor_bands
    change = suspension_change(machine, parameters, bands.scheme.centres * speed / (2.0 * math.pi))
    motion = change @ prepared.power @ np.conj(np.swapaxes(change, -1, -2))
    edges = bands.scheme.edges_hz(speed)[list(prepared.cuts)]
    middle = suspension_change(machine, parameters, 0.5 * (edges[:-1] + edges[1:]))
    seen = transform_power(bands.cyclic, sensing.channels)
    cyclic = np.empty_like(seen)
    for place, cycle in enumerate(CYCLES):
        # Lines so many orders higher are in another band where bands are single orders.
        above = np.arange(len(middle)) + np.where(np.arange(len(middle)) < FEATURE_ORDERS, cycle, 0)
        passed = middle[np.minimum(above, len(middle) - 1)]
        whole = passed @ seen[:, place] @ np.conj(np.swapaxes(middle, -1, -2))
        cyclic[:, place] = 0.5 * (whole + np.swapaxes(whole, -1, -2))
    own = prepared.floor.band_power(bands.scheme.edges_hz(speed), sensing.derivatives)
    # What the channels have more of than independent sensors explain is converted, too.
    noise = np.maximum(
        np.einsum("bcs,bs->bc", np.abs(change @ sensing.channels) ** 2, own),
        np.einsum("bcd,bd->bc", np.abs(change) ** 2, prepared.noise_power),
    )
    step = note_step(
        "suspension",
        parameters={path: float(value) for path, value in parameters.items()},
        found="converted to the frame and supports of the machine file",
    )
    return dataclasses.replace(
        prepared,
        sensor_bands=dataclasses.replace(
            bands,
            power=transform_power(motion, sensing.transform),
            cyclic=transform_power(cyclic, sensing.transform),
        ),
        noise_power=noise,
        steps=(*prepared.steps, step),
    )
