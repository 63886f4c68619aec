"""What is said of sliding joints whose friction holds them: jammed, locked, or creeping."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jointplay.solver.arrays import FloatArray
from jointplay.solver.equations.model import Model
from jointplay.solver.equations.numbers import evaluate
from jointplay.solver.machines.joints import SlidingJoint

#: A joint that is slower than its friction velocity is held where its acceleration is below this part of what its
#: friction could give: a joint that only turns round has its largest acceleration there.
_HELD = 0.05
#: Nor does one creep that is slower than this part of the friction velocity: it stands.
_STANDING = 1e-6
#: Above so many friction velocities all friction is there (tanh 3 = 0.995), and no damper that asks for small steps.
_SATURATED = 3.0


def jam_message(model: Model, t: float, z: FloatArray, v: FloatArray, p: Sequence[float]) -> str:
    """Which joint jams, from the state before: that with the most friction times leverage, and others above 1.

    Parameters
    ----------
    model : Model
        With rubbing joints.
    t : float
    z, v : (n,) arrays
    p : sequence of float
        Lane parameters.
    """
    assert model.rubbing is not None
    friction, _, rate, leverage, *_ = _state(model, t, z, v, p)
    product = friction * np.abs(leverage)
    worst = int(product.argmax())
    named = [i for i in range(len(product)) if i == worst or product[i] >= 1]
    joints = " and ".join(model.rubbing.joints[i] for i in named)
    figures = " and ".join(f"{friction[i]:.3g} x {abs(leverage[i]):.3g} at {rate[i]:.3g} m/s" for i in named)
    return (
        f"sliding joint {joints} jammed at {t:.6g} s: friction x leverage is {figures}, and no motion fulfils the "
        "friction law; lower the friction, or change the geometry"
    )


def hold_remark(model: Model, t: float, z: FloatArray, v: FloatArray, p: Sequence[float]) -> str:
    """Remark on a joint that its friction holds at the end of a run; empty where there is none.

    The friction law has no standstill: a joint that friction would hold creeps, slower than its friction velocity. It
    is locked, whatever the force that pushes it, where friction times leverage is 1 or more; else it only sticks.

    Parameters
    ----------
    model : Model
    t : float
    z, v : (n,) arrays
    p : sequence of float
        Lane parameters.
    """
    if model.rubbing is None:
        return ""
    remarks = []
    friction, slow, rate, leverage, mobility, acceleration, normal = _state(model, t, z, v, p)
    for i, name in enumerate(model.rubbing.joints):
        joint, speed = model.machine.joints[name], abs(rate[i])
        if isinstance(joint, SlidingJoint) and joint.friction_law == "bristle":
            continue  # it does not creep
        if not _STANDING * slow[i] < speed < slow[i]:
            continue
        creeps = f"what it moves is the creep of the friction law, {1e3 * speed:.2g} mm/s at the end"
        # Friction presses the surfaces together where its effect on the normal force has the normal force's sign.
        tightens = normal[i] * leverage[i] * rate[i] < 0
        if friction[i] * abs(leverage[i]) >= 1 and tightens:
            figures = f"friction x leverage is {friction[i]:.3g} x {abs(leverage[i]):.3g}"
            remarks.append(f"sliding joint {name} locks itself: {figures}; {creeps}")
        elif abs(acceleration[i]) < _HELD * friction[i] * abs(normal[i]) * mobility[i]:
            remarks.append(f"sliding joint {name} sticks: {creeps}")
    return "; ".join(remarks)


def failure_remark(model: Model, t: float, z: FloatArray, v: FloatArray, p: Sequence[float]) -> str:
    """Joints that can lock themselves, or that friction holds, at the end of a run that failed, and a cure.

    Parameters
    ----------
    model : Model
    t : float
    z, v : (n,) arrays
        Where it ended.
    p : sequence of float
        Lane parameters.

    Returns
    -------
    str
        Empty where friction holds no joint, or where what is left of the motion says nothing.
    """
    if model.rubbing is None or not (np.isfinite(z).all() and np.isfinite(v).all()):
        return ""
    remarks = []
    friction, slow, rate, leverage, mobility, acceleration, normal = _state(model, t, z, v, p)
    for i, name in enumerate(model.rubbing.joints):
        pressed = friction[i] * abs(normal[i])
        if friction[i] * abs(leverage[i]) >= 1:
            figures = f"{friction[i]:.3g} x {abs(leverage[i]):.3g}"
            remarks.append(f"sliding joint {name} can lock itself: friction x leverage is {figures}")
        elif abs(rate[i]) < _SATURATED * slow[i] and abs(acceleration[i]) < _HELD * pressed * mobility[i]:
            moving = f"pressed by {abs(normal[i]):.3g} N, it creeps at {1e3 * abs(rate[i]):.2g} mm/s"
            remarks.append(f"sliding joint {name} is held by a friction of {friction[i]:.3g}: {moving}")
    return f"{'; '.join(remarks)}; lower the friction, or raise the friction velocity" if remarks else ""


def _state(model: Model, t: float, z: FloatArray, v: FloatArray, p: Sequence[float]) -> list[FloatArray]:
    return [part[:, 0] for part in evaluate(model.rubbing_state, t, z, v, p)]
