"""The machine without play on a frame that stands still: where all bodies are at an angle of the drive."""

from __future__ import annotations

import math

import numpy as np

from second_simulator.machine import Array, Machine, Point


class Ideal:
    """Closed joints as equations of all coordinates; solved by Newton's method from the drawing."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self._index = {name: place for place, name in enumerate(machine.bodies)}
        self.drawn: Array = np.array([(*body.at, 0.0) for body in machine.bodies.values()])

    def _point(self, q: Array, body: str, at: Point) -> tuple[Array, Array]:
        """A point of a body, and its derivative (2, 3) by the body's coordinates."""
        i, centre = self._index[body], self.machine.bodies[body].at
        x, y = at[0] - centre[0], at[1] - centre[1]
        c, s = math.cos(q[i, 2]), math.sin(q[i, 2])
        arm = np.array([c * x - s * y, s * x + c * y])
        return q[i, :2] + arm, np.array([[1.0, 0.0, -arm[1]], [0.0, 1.0, arm[0]]])

    def equations(self, q: Array, theta: float) -> tuple[Array, Array]:
        """Residuals (m,) and their derivatives (m, 3 N): joints, drive, frame."""
        machine, index = self.machine, self._index
        values: list[float] = []
        rows: list[Array] = []

        def add(value: float, *parts: tuple[str, Array]) -> None:
            row = np.zeros(q.size)
            for body, part in parts:
                row[3 * index[body] : 3 * index[body] + 3] += part
            values.append(value)
            rows.append(row)

        turn = np.array([0.0, 0.0, 1.0])
        for pin in machine.pins.values():
            one, by_one = self._point(q, pin.pin, pin.at)
            other, by_other = self._point(q, pin.socket, pin.at)
            for axis in (0, 1):
                add(float(one[axis] - other[axis]), (pin.pin, by_one[axis]), (pin.socket, -by_other[axis]))
        for guide in machine.guides.values():
            one, by_one = self._point(q, guide.slider, guide.at)
            other, by_other = self._point(q, guide.rail, guide.at)
            angle = q[index[guide.rail], 2]
            c, s = math.cos(angle), math.sin(angle)
            d = np.array(
                [c * guide.direction[0] - s * guide.direction[1], s * guide.direction[0] + c * guide.direction[1]]
            )
            n, apart = np.array([-d[1], d[0]]), one - other
            add(float(n @ apart), (guide.slider, n @ by_one), (guide.rail, -n @ by_other - d @ apart * turn))
            add(q[index[guide.slider], 2] - angle, (guide.slider, turn), (guide.rail, -turn))
        drive = machine.drive
        assert drive is not None
        add(q[index[drive.driven], 2] - q[index[drive.base], 2] - theta, (drive.driven, turn), (drive.base, -turn))
        frame = index[machine.frame]
        for axis in range(3):
            add(q[frame, axis] - self.drawn[frame, axis], (machine.frame, np.eye(3)[axis]))
        return np.array(values), np.array(rows)

    def places(self, theta: float, near: Array) -> Array:
        """Coordinates (N, 3) at an angle, from coordinates nearby."""
        return self._closed(theta, near)[0]

    def _closed(self, theta: float, near: Array) -> tuple[Array, Array]:
        """Coordinates at an angle, and the derivatives of the equations there."""
        q = near.copy()
        for _ in range(30):
            value, rows = self.equations(q, theta)
            if np.abs(value).max() < 1e-13:
                return q, rows
            q -= _solved(rows, value).reshape(q.shape)
        raise ArithmeticError(f"{self.machine.name} does not close at {theta:.3f} rad")

    def velocities(self, q: Array, theta: float, speed: float) -> Array:
        """Velocities (N, 3) at a speed of the drive."""
        _, rows = self.equations(q, theta)
        return self._rates(rows, speed).reshape(q.shape)

    def _rates(self, rows: Array, speed: float) -> Array:
        wanted = np.zeros(len(rows))
        wanted[-4] = speed  # the drive's row; the frame's three come last
        return _solved(rows, wanted)

    def revolution(self, count: int) -> tuple[Array, Array]:
        """Places and velocities for a speed of 1 rad/s, each (count, N, 3), over one turn."""
        q, step, places, rates = self.drawn, 2 * math.pi / count, [], []
        v = np.zeros_like(q)
        for k in range(count):
            q, rows = self._closed(k * step, q + step * v)
            v = self._rates(rows, 1.0).reshape(q.shape)
            places.append(q)
            rates.append(v)
        return np.array(places), np.array(rates)


def _solved(rows: Array, wanted: Array) -> Array:
    """Solution of all equations; of bodies that none of them holds, the least."""
    if rows.shape[0] == rows.shape[1]:
        return np.asarray(np.linalg.solve(rows, wanted))
    return np.asarray(np.linalg.lstsq(rows, wanted, rcond=None)[0])
