"""Random machines and random states of them, the same for the same seed.

A machine grows from its frame: a link on a turning or sliding pair, two links that close a loop (a dyad, which neither
adds nor takes a freedom), or a body held by supports alone. Any pair may get clearance, or the drive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jointplay.solver.equations.model import Model
from jointplay.solver.equations.rubbing import MOST
from jointplay.solver.machines.machine import Machine, parse_machine

Array = NDArray[np.float64]

_SINGLE_MOVES = ("turning", "sliding", "body")
_MOVES = (*_SINGLE_MOVES, "dyad", "dyad")
#: Pairs of a dyad: outer, between the two links, outer. Three sliding pairs would fix no angle.
_DYADS = ("TTT", "TTS", "STT", "TST", "STS", "TSS")
_LOCKS: tuple[dict[str, Any], ...] = (
    {"fixed": True},
    {"locked": ["x"]},
    {"locked": ["y", "theta"]},
    {"locked": ["theta"]},
    {"locked": ["x", "y"]},
)
#: Links other than the frame with a lock.
_LOCKED_SHARE = 0.05
#: Half of the contacts are linear.
_LAWS = (*["linear"] * 5, "hertz", "hunt-crossley", "flores", "gonthier", "lankarani-nikravesh")
_DIRECTIONS = ("any", "vertical", "horizontal", "downward")
_DRIVES = {"turning": ("rotation", "rotation", "torque"), "sliding": ("translation", "force", "force")}
#: Longest time of a random state, s: with speeds to 30 rad/s the drive turns up to one radian.
_LATEST = 0.03


@dataclass(frozen=True)
class Sketch:
    """A machine, the clearances of its worn joints (m), and the seed of its states."""

    machine: Machine
    clearances: dict[str, float]
    seed: int


@dataclass
class _Draft:
    rng: np.random.Generator
    links: dict[str, dict[str, Any]] = field(default_factory=dict)
    joints: dict[str, dict[str, Any]] = field(default_factory=dict)
    supports: list[dict[str, Any]] = field(default_factory=list)

    def near(self, *points: Any, spread: float = 0.1) -> list[float]:
        centre = np.mean(np.array(points, dtype=float), axis=0)
        return [float(x) for x in centre + self.rng.uniform(-spread, spread, 2)]

    def between(self, low: float, high: float) -> float:
        """Random on a logarithmic scale."""
        return float(math.exp(self.rng.uniform(math.log(low), math.log(high))))

    def link(self, cg: list[float], **more: Any) -> str:
        name = f"L{len(self.links)}"
        mass = self.between(0.2, 5.0)
        radius = float(self.rng.uniform(0.05, 0.2))
        if self.links and self.rng.random() < _LOCKED_SHARE:
            more = self.choose(_LOCKS)
        self.links[name] = {"mass": mass, "inertia": mass * radius**2, "cg": cg, **more}
        return name

    def choose(self, options: Sequence[Any]) -> Any:
        return options[int(self.rng.integers(len(options)))]

    def pick(self) -> str:
        return str(self.choose(sorted(self.links)))

    def joint(self, kind: str, one: str, other: str) -> None:
        """Kind T or S, the two links in either order."""
        links = [one, other] if self.rng.random() < 0.5 else [other, one]
        at = self.near(self.links[one]["cg"], self.links[other]["cg"])
        data: dict[str, Any] = {"links": links, "at": at}
        if kind == "S":
            angle = float(self.rng.uniform(0, 2 * math.pi))
            named = {"vertical": [0, 1], "downward": [0, -1], "horizontal": [1, 0]}
            direction = named.get(self.choose(_DIRECTIONS), [math.cos(angle), math.sin(angle)])
            data |= {"kind": "sliding", "direction": direction}
            data["viscous"] = float(self.rng.choice([0.0, self.between(1, 100)]))
            friction = float(self.rng.choice([0.0, self.between(0.02, 1.0), self.rng.uniform(0.3, 1.0)]))
            rubbing = sum(1 for joint in self.joints.values() if joint.get("friction"))
            data["friction"] = friction if rubbing < MOST else 0.0
            data["friction_velocity"] = self.between(1e-3, 0.1)
        else:
            data |= {"kind": "turning", "pin": str(self.rng.choice(links)), "contact": self.contact()}
            data["pin_radius"] = float(self.rng.choice([0.0, self.between(1e-3, 2e-2)]))
            data["viscous"] = float(self.rng.choice([0.0, self.between(1e-3, 1.0)]))
        self.joints[f"J{len(self.joints)}"] = data

    def normal_law(self) -> dict[str, Any]:
        law = str(self.rng.choice(_LAWS))
        if law == "linear":
            damping = float(self.rng.choice([0.0, self.between(10, 1e3)]))
            return {"law": law, "stiffness": self.between(1e5, 1e8), "damping": damping}
        loss = {"hysteresis": self.between(0.01, 10)} if law == "hertz" else {"restitution": self.between(0.05, 1)}
        exponent = float(self.rng.choice([1.5, 1.5, 1.0, 2.5, self.between(1, 3)]))
        # Forces at 0.1 mm are those of the linear law.
        stiffness = self.between(1e5, 1e8) * 1e-4 ** (1 - exponent)
        return {"law": law, "stiffness": stiffness, "exponent": exponent, **loss}

    def contact(self) -> dict[str, Any]:
        return {
            **self.normal_law(),
            "friction": float(self.rng.choice([0.0, self.between(0.02, 1.0)])),
            "viscous": float(self.rng.choice([0.0, self.between(0.1, 100)])),
            "friction_velocity": self.between(1e-3, 0.1),
        }

    def grow(self, room: int) -> None:
        move = self.choose(_MOVES if len(self.links) > 1 and room > 1 else _SINGLE_MOVES)
        base = self.pick()
        if move == "dyad":
            other = self.choose([name for name in self.links if name != base])
            first = self.link(self.near(self.links[base]["cg"], spread=0.3))
            second = self.link(self.near(self.links[other]["cg"], self.links[first]["cg"], spread=0.3))
            pairs = self.choose(_DYADS)
            for kind, links in zip(pairs, ((base, first), (first, second), (second, other)), strict=True):
                self.joint(kind, *links)
        elif move == "body":
            body = self.link(self.near(self.links[base]["cg"], spread=0.3))
            self.support(body)
        else:
            self.joint(move[0].upper(), base, self.link(self.near(self.links[base]["cg"], spread=0.3)))

    def support(self, link: str) -> None:
        others = [name for name in self.links if name != link]
        to_link = self.choose([None, *others])
        data: dict[str, Any] = {"link": link, "at": self.near(self.links[link]["cg"]), "to_link": to_link}
        kind = self.choose(("spring", "spring", "damper", "mount"))
        stiffness = [self.between(1e2, 1e5) for _ in range(2)]
        damping = [self.between(1, 300) for _ in range(2)]
        if kind == "mount":
            data |= {"stiffness": stiffness, "damping": damping}
        else:
            angle = self.rng.uniform(0, 2 * math.pi)
            x, y = data["at"]
            data["anchor"] = [x + 0.3 * math.cos(angle), y + 0.3 * math.sin(angle)]
        if kind == "spring":
            data["stiffness"] = stiffness[0]
            data |= [{}, {"free_length": 0.25}, {"static_deflection": 0.01}][self.rng.integers(3)]
        elif kind == "damper":
            data["damping"] = damping[0]
        self.supports.append({"kind": kind, **data})

    def drive(self) -> dict[str, Any] | None:
        if not self.joints or self.rng.random() < 0.15:
            return None
        name = self.choose(sorted(self.joints))
        kind = self.choose(_DRIVES[self.joints[name]["kind"]])
        data: dict[str, Any] = {"kind": kind, "joint": name}
        phase = float(self.rng.uniform(-3, 3))
        ramped = self.rng.random() < 0.4
        if kind == "rotation":
            w = self.rng.uniform(-30, 30, 3)
            data["speed"] = [[0.005, w[0]], [0.012, w[1]], [0.02, w[2]]] if ramped else float(w[0])
            orders = self.rng.choice([1, 2, 3.5], int(self.rng.integers(3)), replace=False)
            data["ripple"] = [{"order": float(k), "amplitude": 0.02, "phase": phase + float(k)} for k in orders]
        elif kind == "translation":
            s = self.rng.uniform(-1, 1, 2)
            data["speed"] = [[0.0, s[0]], [0.02, s[1]]] if ramped else float(s[0])
            data["harmonics"] = [{"frequency": 5.0, "amplitude": 0.01, "phase": phase}][: int(self.rng.integers(2))]
        else:
            strength = 20.0 if kind == "torque" else 300.0
            values = self.rng.uniform(-strength, strength, 3)
            curve = [[-5.0, values[0]], [1.0, values[1]], [6.0, values[2]]]
            factors = {"effort_factor": 1.5, "speed_factor": 0.8}
            data |= {"curve": curve, **factors} if ramped else {kind: float(values[0])}
        return data

    def shift(self, kind: str) -> dict[str, Any]:
        """Part of an anchor's motion, up to 1 cm and 2 m/s."""
        if kind == "over_time":
            return {kind: [[t, *self.rng.uniform(-0.01, 0.01, 2).tolist()] for t in (0.001, 0.011, 0.021)]}
        often = {"frequency": self.between(1, 30)} if kind == "frequency" else {"order": self.choose((1, 2, 0.37))}
        return {
            "displacement": self.rng.uniform(-0.01, 0.01, 2).tolist(),
            "phase": float(self.rng.uniform(-3, 3)),
            **often,
        }

    def load(self, *, by_angle: bool) -> dict[str, Any]:
        link = self.pick()
        data: dict[str, Any] = {"link": link, "at": self.near(self.links[link]["cg"])}
        rows = self.rng.uniform(-1, 1, (3, 3)) * [200, 200, 10]
        kinds = ("constant", "over_time", "over_angle", "order") if by_angle else ("constant", "over_time")
        kind = self.choose(kinds)
        if kind == "constant":
            return data | {"force": list(rows[0, :2]), "torque": rows[0, 2]}
        if kind == "order":
            waves = {"order": int(self.rng.integers(1, 7)), "phase": float(self.rng.uniform(-3, 3))}
            return data | {"force": list(rows[0, :2]), "torque": rows[0, 2]} | waves
        start = float(self.rng.uniform(-0.5, 0.5))
        arguments = (0.0, 0.01, 0.02) if kind == "over_time" else (start, start + 0.4, start + 2.0)
        return data | {kind: [[x, *row] for x, row in zip(arguments, rows.tolist(), strict=True)]}


def _loosen(joints: dict[str, dict[str, Any]], seed: int) -> dict[str, float]:
    """Give every guide a block; clearances of those that are worn. Drawn apart: all else is as without them."""
    draft, worn = _Draft(np.random.default_rng([seed, 2])), {}
    for name, joint in joints.items():
        if joint["kind"] == "sliding":
            joint["length"] = draft.between(0.02, 0.2)
            joint["height"] = draft.choose((0.0, draft.between(0.01, 0.1)))
            joint["contact"] = draft.contact()
            if draft.rng.random() < 0.25:
                worn[name] = draft.between(1e-5, 1e-3)
    return worn


def _oil(joints: dict[str, dict[str, Any]], seed: int) -> None:
    """Give some pins a film. Drawn apart: all else is as without them."""
    draft = _Draft(np.random.default_rng([seed, 3]))
    for joint in joints.values():
        if joint.get("pin_radius") and draft.rng.random() < 0.3:
            viscosity, length = draft.between(1e-4, 10.0), draft.between(5e-3, 0.1)
            joint["film"] = {"viscosity": viscosity, "length": length, "roughness": draft.between(1e-7, 1e-5)}


def _shake(supports: list[dict[str, Any]], seed: int, *, by_angle: bool) -> None:
    """Let the ground of some supports move. Drawn apart: all else is as without it."""
    draft = _Draft(np.random.default_rng([seed, 4]))
    kinds = ("frequency", "over_time", "order") if by_angle else ("frequency", "over_time")
    for support in supports:
        if support["to_link"] is None and draft.rng.random() < 0.3:
            support["motion"] = [draft.shift(draft.choose(kinds)) for _ in range(int(draft.rng.integers(1, 3)))]


def _in_space(
    links: dict[str, dict[str, Any]], drive: dict[str, Any] | None, seed: int
) -> dict[str, Any] | None:  # fmt: skip
    """The drive, or one of a link in space in place of a force or of none. Drawn apart, as above."""
    draft = _Draft(np.random.default_rng([seed, 5]), links)
    link, angle, s = draft.pick(), float(draft.rng.uniform(0, 2 * math.pi)), draft.rng.uniform(-1, 1, 2)
    other = drive is not None and drive["kind"] != "force"
    locked = links[link].get("fixed") or {"x", "y"} & set(links[link].get("locked", ()))
    if other or locked or draft.rng.random() < 0.3:
        return drive
    direction = draft.choose(([1, 0], [0, 1], [math.cos(angle), math.sin(angle)]))
    speed = [[0.0, s[0]], [0.02, s[1]]] if draft.rng.random() < 0.4 else float(s[0])
    harmonics = [{"frequency": 5.0, "amplitude": 0.002, "phase": angle}][: int(draft.rng.integers(2))]
    return {"kind": "position", "link": link, "direction": direction, "speed": speed, "harmonics": harmonics}


def sketch(seed: int) -> Sketch:
    """A machine of 3 to 12 links with anything that a machine file can say."""
    draft = _Draft(np.random.default_rng(seed))
    count = int(draft.rng.integers(3, 13))
    draft.link([0.0, 0.0], **draft.choose(({}, {}, *_LOCKS)))
    while len(draft.links) < count:
        draft.grow(count - len(draft.links))
    for _ in range(int(draft.rng.integers(5))):
        draft.support(draft.pick())
    drive = draft.drive()
    turning = [name for name, joint in draft.joints.items() if joint["kind"] == "turning"]
    worn = [str(name) for name in draft.rng.permutation(turning)[: draft.rng.integers(4)]]
    by_angle = drive is not None and drive["kind"] in ("rotation", "torque")
    names = list(draft.links)
    draft.rng.shuffle(names)  # the frame may stand anywhere in the file
    guides = _loosen(draft.joints, seed)
    _oil(draft.joints, seed)
    _shake(draft.supports, seed, by_angle=by_angle)
    tree = {
        "name": "drawn",
        "frame": "L0",
        "gravity": draft.choose((9.81, 0.0, -3.0)),
        "links": {name: draft.links[name] for name in names},
        "joints": draft.joints,
        "supports": draft.supports,
        "loads": [draft.load(by_angle=by_angle) for _ in range(int(draft.rng.integers(3)))],
        "drive": _in_space(draft.links, drive, seed),
    }
    return Sketch(parse_machine(tree), {name: draft.between(1e-5, 1e-2) for name in worn} | guides, seed)


def bent_sketch(seed: int) -> Sketch:
    """The machine of a seed with one to three modes of its frame, in proportion far softer than any."""
    rigid, rng = sketch(seed), np.random.default_rng([seed, 3])

    def mode() -> dict[str, Any]:
        points = dict.fromkeys(at for _, at in rigid.machine.frame_points)
        moved, turned = rng.uniform(-0.5, 0.5, (len(points), 2)), rng.uniform(-2, 2, len(points))
        turned[rng.random(len(points)) < 0.3] = 0.0
        return {
            "frequency": math.exp(rng.uniform(1, 6)),
            "damping": rng.uniform(0, 0.3),
            "mass": math.exp(rng.uniform(-1, 2)),
            "shape": [
                {"at": at, "displacement": move, "rotation": turn}
                for at, move, turn in zip(points, moved.tolist(), turned.tolist(), strict=True)
            ],
        }

    modes = [mode() for _ in range(int(rng.integers(1, 4)))]
    return Sketch(parse_machine(rigid.machine.model_dump() | {"modes": modes}), rigid.clearances, seed)


def random_state(model: Model, p: list[float], seed: int) -> tuple[float, Array, Array] | None:
    """A time, coordinates and velocities that fulfil joints and drive; pins and ends of blocks anywhere between their
    walls or pressed in.

    Far from the drawing first, nearer and nearer where the loops do not close there. ``None`` where they never do.
    """
    rng = np.random.default_rng([seed, 1])
    angles = np.array([name.startswith("theta(") for name in model.kinematics.names], dtype=bool)
    turn = rng.uniform(-3, 3) if model.frame_indices[2] is not None else 0.0  # of the machine as a whole
    spread = np.where(angles, rng.uniform(-0.4, 0.4, model.size), rng.uniform(-0.05, 0.05, model.size))
    latest = float(rng.uniform(0, _LATEST))
    pins = np.zeros(2 * len(model.clearance_joints))
    for k, joint in enumerate(model.clearance_joints):
        clearance = p[model.parameters.index(f"joints.{joint}.clearance")]
        inside, outside = clearance * rng.uniform(0, 0.98), clearance + float(np.exp(rng.uniform(-14, -8)))
        size, angle = inside if rng.random() < 0.35 else outside, rng.uniform(0, 2 * math.pi)
        way = np.array([math.cos(angle), math.sin(angle)])
        # Of a block at one or both of its ends, on one side or on both.
        ends = (np.sign(way), np.rint(1.2 * way))[int(4 * angle) % 2]
        pins[2 * k : 2 * k + 2] = size * (ends if joint in model.machine.sliding_joints else way)
    for nearness in (1.0, 0.5, 0.2, 0.05):
        t = latest * nearness
        z = _closed(model, t, nearness * spread + np.where(angles, turn, 0.0), p, pins)
        if z is not None:
            break
    else:
        return None
    v = np.where(angles, rng.uniform(-20, 20, model.size), rng.uniform(-1, 1, model.size))
    closures = len(model.kinematics.closures)
    if closures:
        jacobian, drift = (
            np.asarray(part.full())[:closures] for part in model.constraint(t, z, np.zeros(model.size), p)[1:]
        )
        v = v - np.linalg.lstsq(jacobian, jacobian @ v + drift[:, 0], rcond=1e-9)[0]
    return t, z, v


def _closed(model: Model, t: float, z: Array, p: list[float], pins: Array) -> Array | None:
    """Newton's method on the closures and the places of the pins."""
    rest = np.zeros(model.size)
    for _ in range(20):
        value, jacobian, _ = (np.asarray(part.full()) for part in model.constraint(t, z, rest, p))
        gap = value[:, 0]
        if pins.size:
            gap[-pins.size :] -= pins
        if np.abs(gap).max(initial=0.0) < 1e-14:
            return z
        z = z - np.linalg.lstsq(jacobian, gap, rcond=1e-9)[0]
    return z if np.abs(gap).max() < 1e-13 else None


def parameters(model: Model, clearances: dict[str, float]) -> list[float]:
    """Lane parameters of the machine as filed with these clearances."""
    return model.vector({f"joints.{name}.clearance": value for name, value in clearances.items()})
