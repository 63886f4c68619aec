"""The oil between a pin and its socket, by hand: pressures and shear stresses, summed over the circumference."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from oracle.state import Array, State, across
from scipy.integrate import quad

from jointplay.solver.machines.joints import TurningJoint


@dataclass(frozen=True)
class OilState:
    """Force on the pin at its centre, its opposite acts on the socket at that one's; and the torques on both."""

    pin: int
    socket: int
    centres: tuple[Array, Array]
    force: Array
    torques: tuple[float, float]

    @classmethod
    def of(cls, state: State, name: str, clearance: float) -> OilState | None:
        joint = state.machine.joints[name]
        if not isinstance(joint, TurningJoint) or joint.film is None:
            return None
        oil, radius = joint.film, joint.pin_radius
        pin, socket = state.index(joint.pin), state.index(next(link for link in joint.links if link != joint.pin))
        centres = state.point(pin, joint.at), state.point(socket, joint.at)
        e = centres[0] - centres[1]
        omegas = state.omega(pin, joint.at), state.omega(socket, joint.at)
        relative = state.velocity(pin, joint.at) - state.velocity(socket, joint.at)
        v = relative - sum(omegas) / 2 * across(e)
        thinnest = max(min(oil.roughness, clearance / 2), clearance / 1000)
        size = float(np.hypot(*e))
        near = e * min(1.0, (clearance - thinnest) / size) if size else e

        def around(what: Callable[[Array, float], float], *, half: bool, least: float = 0.0) -> float:
            """Over the half before V, where pressure is, or all the circumference; `least` counts as nothing."""
            middle = math.atan2(v[1], v[0])
            low, high = (middle - math.pi / 2, middle + math.pi / 2) if half else (0.0, 2 * math.pi)
            peak = low + (math.atan2(near[1], near[0]) - low) % (2 * math.pi)
            points = [peak] if low < peak < high else None

            def at(angle: float) -> float:
                u = np.array([math.cos(angle), math.sin(angle)])
                return what(u, clearance - float(near @ u))

            return float(quad(at, low, high, points=points, epsabs=least, epsrel=1e-12, limit=400)[0])

        unit = oil.viscosity * radius * oil.length**3
        none = 1e-12 * around(lambda u, h: float(v @ u) / h**3, half=True)
        parts = (around(lambda u, h, k=k: float(v @ u) / h**3 * u[k], half=True, least=none) for k in (0, 1))
        force = -unit * np.array(list(parts))
        # Flow along falling pressure drags both surfaces with h/2 dp/ds; by parts, p dh/2.
        least = none * float(np.hypot(*near)) or 1e-99
        drag = unit * around(lambda u, h: float(v @ u * (-near @ across(u))) / h**3 / 2, half=True, least=least)
        if size:
            drag *= size / float(np.hypot(*near))  # about the centres where they are, not where the film counts them
        shear = oil.viscosity * radius**3 * oil.length * around(lambda u, h: 1 / h, half=False)
        # Held where it is too fast to be followed, and faded once the surfaces have met.
        full = unit * around(lambda u, h: float(near @ u) ** 2 / (near @ near) / h**3, half=False) if size else 0.0
        full = full or unit * math.pi / clearance**3
        masses = [link.mass for link in (state.machine.links[each] for each in joint.links) if link.mass]
        fading = min(1.0, max(0.0, 1 - (size - clearance) / thinnest))
        share = fading * min(1.0, 1e8 * min(masses, default=1.0) / full)
        turning = fading * shear * float(omegas[0] - omegas[1])
        return cls(pin, socket, centres, share * force, (share * drag - turning, share * drag + turning))
