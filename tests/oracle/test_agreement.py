"""The solver's accelerations and reactions against the paper's dense equations, on random machines at random states.

Both sides see the same state: coordinates of the solver, and from them positions and velocities of all links. The
oracle checks first that these fulfil its own closures, locks and drive, so wrong kinematics cannot hide either.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from oracle.closures import lacking
from oracle.dense import JammedError, Solution, solve
from oracle.sketch import Sketch, bent_sketch, parameters, random_state, sketch
from oracle.state import ContactState, CornerState, State

from jointplay.solver.equations.links import LinkMotion, link_motion
from jointplay.solver.equations.model import build_model
from jointplay.solver.errors import AssemblyError
from jointplay.solver.machines.joints import SlidingJoint
from jointplay.solver.machines.machine import Machine
from jointplay.solver.machines.parts import MotionDrive, RotationDrive

#: Largest difference, as part of the largest term of the equations. What is not the solver's fault sets it: a pin
#: pressed 1e-6 m into a socket of 1e8 N/m loses six digits of sixteen before any equation is written.
TOLERANCE = 1e-10
#: Machines are refused as ill-conditioned above this condition number of the oracle's scaled matrix: near dead centres,
#: or with more constraints than freedoms, the equations themselves do not determine ten digits.
CONDITION = 1e5
#: Machines tried; some have no state, or equations that determine nothing.
MACHINES = 170
#: Closures hold to this, m, rad and their rates at speeds of 20 rad/s.
CLOSED = 1e-12


def difference(machine: Machine, solution: Solution, motion: LinkMotion, modes: np.ndarray) -> float:
    """Largest of all accelerations, the modes' among them, reactions and the drive's effort, each as part of its kind's
    scale.
    """
    gap = np.abs(motion.acceleration[0] - solution.accelerations)
    (linear, angular), (force, moment) = solution.scale, solution.effort_scale
    parts = [gap[:, :2].max() / (linear or 1.0), gap[:, 2].max() / (angular or 1.0)]
    expected: dict[str, tuple[np.ndarray | float, float]] = {}
    for name, joint in machine.joints.items():
        reaction = solution.reactions[name]
        if isinstance(joint, SlidingJoint):
            expected |= {f"normal_{name}": (reaction[0], force), f"couple_{name}": (reaction[1], moment)}
        else:
            worn = f"force_{name}_on_pin"
            expected[worn if worn in motion.reactions else f"force_{name}"] = (reaction, force)
    if isinstance(machine.drive, MotionDrive):
        scale = moment if isinstance(machine.drive, RotationDrive) else force
        expected["drive_effort"] = (solution.effort, scale)
    assert set(expected) <= set(motion.reactions)
    if machine.modes:
        parts.append(np.abs(modes - solution.modes).max() / (solution.mode_scale or 1.0))
    parts += [
        np.abs(motion.reactions[name][0] - value).max() / (scale or 1.0) for name, (value, scale) in expected.items()
    ]
    return float(max(parts))


def features(sketch: Sketch, state: State) -> set[str]:
    """What a scene shows, so that the test can prove what it has tested."""
    machine = sketch.machine
    frame = machine.links[machine.frame]
    count = len(machine.links)
    seen = {"3 links" if count == 3 else "4 to 8 links" if count < 9 else "9 to 12 links", f"gravity {machine.gravity}"}
    seen.add("fixed frame" if frame.fixed else f"frame locks {len(frame.locked)}")
    seen |= {
        "other lock" for name, link in machine.links.items() if name != machine.frame and (link.fixed or link.locked)
    }
    for name, joint in machine.joints.items():
        if isinstance(joint, SlidingJoint):
            if name in sketch.clearances:
                continue
            seen.add("vertical slide" if joint.direction[0] == 0 else "slide")
            if joint.friction:
                seen.add("vertical rubbing slide" if joint.direction[0] == 0 else "rubbing slide")
        seen |= {f"viscous {joint.kind}"} if joint.viscous else set()
    guides = machine.sliding_joints
    rubbing = [name for name in guides if machine.joints[name].friction and name not in sketch.clearances]
    if len(rubbing) > 1:
        seen.add("several rubbing slides")
    if rubbing:
        seen.add("rubbing on a fixed frame" if frame.fixed else "rubbing on a floating frame")
        seen |= {"rubbing beside a worn joint"} if sketch.clearances else set()
    for name, clearance in sketch.clearances.items():
        law = machine.joints[name]
        if isinstance(law, SlidingJoint):
            corners = CornerState.all(state, name, clearance)
            pressed = [corner for corner in corners if corner.normal_force]
            seen.add(f"{len(pressed)} corners pressed")
            parting = [corner for corner in corners if corner.penetration > 0 and not corner.normal_force]
            seen |= {"corner leaves without pull"} if parting else set()
            if pressed:
                seen |= {"block with a height"} if law.height else {"flat block"}
                seen |= {f"corner {key}" for key in ("friction", "viscous") if getattr(law.contact, key)}
                seen.add(f"corner law {law.contact.law}")
            continue
        contact = ContactState.of(state, name, clearance)
        if law.film is not None:
            seen.add("oil apart" if contact.penetration <= 0 else "oil fading")
        if contact.normal_force == 0:
            seen.add("pin in flight" if contact.penetration <= 0 else "pin leaves without pull")
        else:
            seen.add("pin pressed")
            seen.add(f"law {law.contact.law}")
            seen |= {f"contact {key}" for key in ("damping", "friction", "viscous") if getattr(law.contact, key)}
            seen |= {"pin radius"} if law.pin_radius else set()
    for support in machine.supports:
        seen.add(f"{support.kind} to {'link' if support.to_link else 'ground'}")
        for part in support.motion:
            kinds = ("frequency", "order", "over_time")
            seen |= {f"moving {support.kind}", *(f"motion {kind}" for kind in kinds if getattr(part, kind) is not None)}
    for load in machine.loads:
        of_an_order = "of an order" if load.order else "constant"
        seen.add("load " + ("over time" if load.over_time else "over angle" if load.over_angle else of_an_order))
    drive = machine.drive
    if drive is not None:
        seen.add(drive.kind)
        more = ("ripple", "harmonics", "curve")
        seen |= {f"{drive.kind} {key}" for key in more if getattr(drive, key, None)}
        seen |= {f"{drive.kind} ramp"} if isinstance(getattr(drive, "speed", None), tuple) else set()
        if machine.driven_link:
            seen.add("position of the frame" if machine.driven_link == machine.frame else "position of another link")
        loose = "guide" if machine.driven_joint in guides else "joint"
        seen |= {f"{drive.kind} of a worn {loose}"} if machine.driven_joint in sketch.clearances else set()
    return seen


#: Every one of these must have been seen at least so often among the machines compared.
EXPECTED = {
    "compared": 100,     "3 links": 5, "4 to 8 links": 30, "9 to 12 links": 20, "closed loops": 30, "open chains": 10,
    "gravity 9.81": 10, "gravity 0.0": 10, "fixed frame": 5, "frame locks 0": 10, "frame locks 1": 5,
    "frame locks 2": 5, "other lock": 5, "slide": 20, "vertical slide": 20, "viscous sliding": 20,
    "viscous turning": 20, "rubbing slide": 20, "vertical rubbing slide": 10, "several rubbing slides": 15,
    "rubbing on a fixed frame": 5, "rubbing on a floating frame": 15, "rubbing beside a worn joint": 10, "jammed": 2,
    "pin in flight": 10, "pin pressed": 20, "pin leaves without pull": 2, "contact damping": 10, "contact friction": 10,
    "contact viscous": 10, "pin radius": 10, "law linear": 10, "law hertz": 2, "law hunt-crossley": 2, "law flores": 2,
    "law gonthier": 2, "law lankarani-nikravesh": 2, "spring to ground": 10, "spring to link": 10,
    "damper to ground": 5, "damper to link": 5, "mount to ground": 5, "mount to link": 5, "load constant": 10,
    "load over time": 10,
    "load over angle": 3, "load of an order": 2, "rotation": 10, "rotation ripple": 5, "rotation ramp": 3,
    "translation": 5,
    "translation harmonics": 2, "translation ramp": 2, "torque": 5, "torque curve": 2, "force": 5, "force curve": 2,
    "rotation of a worn joint": 2, "0 corners pressed": 10, "1 corners pressed": 15, "2 corners pressed": 15,
    "corner leaves without pull": 5, "flat block": 15, "block with a height": 15, "corner friction": 15,
    "corner viscous": 15, "corner law linear": 10, "corner law hertz": 2, "corner law hunt-crossley": 2,
    "corner law flores": 2, "corner law gonthier": 2, "corner law lankarani-nikravesh": 2,
    "translation of a worn guide": 2, "force of a worn guide": 2, "oil apart": 5, "oil fading": 5,
    "position of another link": 25, "position of the frame": 2, "position ramp": 10, "position harmonics": 10,
    "moving spring": 10, "moving damper": 2, "moving mount": 4, "motion frequency": 8, "motion order": 4,
    "motion over_time": 8,
}  # fmt: skip


@pytest.mark.long
def test_random_machines() -> None:
    seen: Counter[str] = Counter()
    for seed in range(MACHINES):
        seen += compared(sketch(seed))
    missing = {name: (seen[name], count) for name, count in EXPECTED.items() if seen[name] < count}
    assert not missing, f"not enough of what must be tested, (seen, expected): {missing}"


#: Of what a frame carries, this must have been seen at least so often on frames with modes.
EXPECTED_BENT = {
    "compared": 35, "closed loops": 10, "fixed frame": 5, "slide": 5, "vertical slide": 5, "rubbing slide": 5,
    "viscous turning": 10, "pin pressed": 8, "contact friction": 5, "1 corners pressed": 2, "2 corners pressed": 2,
    "spring to ground": 5, "spring to link": 5, "mount to ground": 2, "mount to link": 2, "rotation": 5,
    "translation": 2, "torque": 2, "force": 2, "load constant": 5, "position": 10, "position of the frame": 2,
    "moving spring": 4,
}  # fmt: skip


@pytest.mark.long
def test_random_machines_whose_frames_bend() -> None:
    seen: Counter[str] = Counter()
    for seed in range(60):
        seen += compared(bent_sketch(seed))
    missing = {name: (seen[name], count) for name, count in EXPECTED_BENT.items() if seen[name] < count}
    assert not missing, f"not enough of what must be tested, (seen, expected): {missing}"


def compared(sketch: Sketch) -> Counter[str]:
    """What a scene has shown, once it agrees; nothing where it has no state or no well-determined equations."""
    nothing: Counter[str] = Counter()
    try:
        model = build_model(sketch.machine, sketch.clearances)
    except AssemblyError:  # the drive turns what sliding pairs hold parallel
        return nothing
    p = parameters(model, sketch.clearances)
    scene = random_state(model, p, sketch.seed)
    if scene is None or (sketch.machine.modes and model.repeats.left_out):  # which a frame that bends does not repeat
        return nothing
    t, z, v = scene
    motion = link_motion(model, p, np.array([t]), z[None], v[None])
    drawn = np.array([(*link.cg, 0.0) for link in sketch.machine.links.values()])
    positions, velocities = motion.displacement[0] + drawn, motion.velocity[0]
    accelerations = np.asarray(model.right_hand_side(t, z, v, p))
    places = model.kinematics.modes
    bent = np.column_stack([z[places], v[places]])
    try:
        solution = solve(sketch.machine, sketch.clearances, t, positions, velocities, bent=bent)
    except np.linalg.LinAlgError:
        return nothing
    except JammedError:
        assert np.isnan(accelerations).all(), sketch.seed
        return Counter({"jammed": 1})
    if solution.condition >= CONDITION:
        return nothing
    assert np.isfinite(accelerations).all(), sketch.seed
    assert lacking(sketch.machine, sketch.clearances, t, positions, velocities, bent) < CLOSED, sketch.seed
    assert difference(sketch.machine, solution, motion, accelerations[places, 0]) < TOLERANCE, sketch.seed
    shape = "closed loops" if model.kinematics.closures else "open chains"
    return Counter({"compared", shape, *features(sketch, State(sketch.machine, positions, velocities, bent=bent))})
