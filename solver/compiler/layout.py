"""Where everything is in the flat work array of a kernel; every quantity is a row of lanes."""

from __future__ import annotations

from dataclasses import dataclass

from jointplay.solver.compiler.ir import LANES


@dataclass(frozen=True)
class Layout:
    """Offsets into the work array, in doubles.

    Attributes
    ----------
    size : int
        Number of coordinates n.
    parameters : int
        Number of lane parameters.
    hoisted : int
        Slots for what depends on the parameters alone.
    extra : int
        Rows for the method's own use.
    memories : int
        Contacts that remember.
    """

    size: int
    parameters: int
    hoisted: int = 0
    extra: int = 0
    memories: int = 0

    def _row(self, index: int) -> int:
        return LANES * index

    @property
    def time(self) -> int:
        """t."""
        return 0

    @property
    def step(self) -> int:
        """h."""
        return self._row(1)

    @property
    def z(self) -> int:
        """Coordinates, n rows."""
        return self._row(2)

    @property
    def v(self) -> int:
        """Velocities, n rows."""
        return self._row(2 + self.size)

    @property
    def a(self) -> int:
        """Accelerations, n rows."""
        return self._row(2 + 2 * self.size)

    @property
    def scratch(self) -> int:
        """2 n rows for the integrator: Gill's running correction of coordinates, then of velocities."""
        return self._row(2 + 3 * self.size)

    @property
    def extra_at(self) -> int:
        """The method's own rows."""
        return self._row(2 + 5 * self.size)

    @property
    def p(self) -> int:
        """Lane parameters."""
        return self._row(2 + 5 * self.size + self.extra)

    @property
    def memory(self) -> int:
        """What contacts remember, see :mod:`jointplay.solver.equations.contact`."""
        return self._row(2 + 5 * self.size + self.extra + self.parameters)

    @property
    def hoist(self) -> int:
        """What depends on the parameters alone."""
        return self.memory + self._row(self.memories)

    @property
    def total(self) -> int:
        """Length of the work array."""
        return self.hoist + self._row(self.hoisted)

    def rows(self, start: int, count: int) -> list[int]:
        """Offsets of `count` rows from `start`."""
        return [start + LANES * i for i in range(count)]
