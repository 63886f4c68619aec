"""Cases on a CUDA device: one case a thread, each with its own time and step.

Imported only where a device is asked for. With ``NUMBA_ENABLE_CUDASIM=1`` Numba runs the same functions on the
processor, as plain Python.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from jointplay.solver.compiler.scalar import SCALAR
from jointplay.solver.equations.model import Model
from jointplay.solver.errors import SettingsError
from jointplay.solver.integrators import stepper
from jointplay.solver.integrators.control import DIVERGING, RUNNING
from jointplay.solver.integrators.dopri import StepRows
from jointplay.solver.integrators.gill import PATIENCE
from jointplay.solver.integrators.kernel import KernelCode, adaptive_code
from jointplay.solver.integrators.lanes import Queue

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: A block is one warp: a few hundred cases then spread over all multiprocessors.
_THREADS = 32
#: Trial steps of a case between two returns to the host: short enough for Ctrl-C and for the watchdog of a device that
#: also drives a screen, long enough that loading and storing the work arrays does not count.
_STRETCH = 2000


def check_device() -> None:
    """Refuse to go on without a device.

    Raises
    ------
    SettingsError
    """
    if not cuda.is_available():
        raise SettingsError("device: cuda: no CUDA device that Numba can use was found")


def memory() -> float:
    """Free memory of the device, bytes."""
    return float(cuda.current_context().get_memory_info()[0])


def case_kernel(code: KernelCode, rows: StepRows, remembering: tuple[int, ...]) -> Callable[..., None]:
    """What a thread runs, before compilation: its case, some trial steps further.

    Parameters
    ----------
    code : KernelCode
        In the scalar dialect.
    rows : StepRows
        Of its work array.
    remembering : tuple of int
        Contacts whose law remembers.

    Notes
    -----
    Between launches `kept` holds the work array and the state of every case, one case a column so that neighbouring
    threads read neighbouring numbers; `fresh` begins the cases. In a launch the work array lies in the thread's local
    memory, whose addresses are constants: they need no arithmetic, and the compiler can tell them apart.
    """
    begin, advance = stepper.case_functions(code, rows, remembering, cuda.jit(device=True))
    length, places = code.layout.total, stepper.state_length(rows.contacts)
    float64 = np.float64

    def advance_case(
        kept: Array, fresh: bool, count: int, interval: float, oversampling: int,
        channels: Indices, coordinates: Array, velocities: Array, accelerations: Array, memories: Array,
    ) -> None:  # fmt: skip
        c = cuda.grid(1)
        if c >= kept.shape[1]:
            return
        w = cuda.local.array(length, float64)
        s = cuda.local.array(places, float64)
        for r in range(length):
            w[r] = kept[r, c]
        for r in range(places):
            s[r] = kept[length + r, c]
        if fresh:
            begin(w, s)
        advance(
            w, s, count, interval, oversampling, channels, coordinates[c], velocities[c],
            accelerations[c], memories[c],
        )  # fmt: skip
        for r in range(length):
            kept[r, c] = w[r]
        for r in range(places):
            kept[length + r, c] = s[r]

    return advance_case


@dataclass(frozen=True, eq=False)
class Records:
    """Recorded motion; all but the velocities at every `oversampling`-th sample.

    Attributes
    ----------
    oversampling : int
    coordinates, velocities, accelerations : (cases, r, samples) arrays
    memories : (cases, m, samples) array
        What contacts remember.
    """

    oversampling: int
    coordinates: Array
    velocities: Array
    accelerations: Array
    memories: Array

    @staticmethod
    def empty(cases: int, channels: int, memories: int, samples: int, oversampling: int, motion: bool) -> Records:
        """Room for all samples; without `motion` for those of the velocities alone."""
        reduced = -(-samples // oversampling) if motion else 0
        counts = ((channels, reduced), (channels, samples), (channels, reduced), (memories, reduced))
        return Records(oversampling, *(np.zeros((cases, *count)) for count in counts))


@dataclass(frozen=True, eq=False)
class Ends:
    """How every case ended.

    Attributes
    ----------
    outcome, reached, accepted : (cases,) arrays of int
        See :mod:`jointplay.solver.integrators.control`; samples recorded; accepted steps.
    finals : (cases, 1 + 2 n + m) array
        Time, coordinates, velocities and memories.
    """

    outcome: Indices
    reached: Indices
    accepted: Indices
    finals: Array


@dataclass(frozen=True)
class DeviceKernel:
    """A model compiled for the device.

    Attributes
    ----------
    code : KernelCode
        In the scalar dialect.
    rows : StepRows
    launch : object
        The compiled :func:`case_kernel`.
    """

    code: KernelCode
    rows: StepRows
    launch: Any

    def integrate(self, queue: Queue, interval: float, records: Records) -> Ends:
        """Integrate cases side by side.

        Parameters
        ----------
        queue : Queue
            Read only.
        interval : float
            Time between samples of the velocities, s.
        records : Records
            Filled in.
        """
        layout, length, cases = self.code.layout, self.code.layout.total, len(queue.starts)
        kept = np.zeros((length + stepper.state_length(self.rows.contacts), cases))
        moving = slice(layout.z, layout.z + 2 * layout.size)
        remembered = slice(layout.memory, layout.memory + layout.memories)
        kept[moving], kept[remembered] = np.split(queue.starts.T, [2 * layout.size])
        kept[layout.p : layout.p + layout.parameters] = queue.parameters.T
        given = (
            (stepper.BEGIN, "begin"), (stepper.TOLERANCE, "tolerance"), (stepper.PACE, "pace"),
            (stepper.FIRST, "first_step"), (stepper.LONGEST, "longest_step"), (stepper.SAMPLES, "samples"),
            (stepper.MOST, "most_trials"), (stepper.PRECISION, "precision"),
        )  # fmt: skip
        for place, name in given:
            kept[length + place] = queue.cases[name]
        there = cuda.to_device(kept)
        channels = cuda.to_device(np.array(self.rows.recorded, dtype=np.int64))
        motions = (records.coordinates, records.velocities, records.accelerations, records.memories)
        results = [cuda.to_device(motion) for motion in motions]
        constants = (interval, records.oversampling)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Grid size")  # Numba's: few cases are no mistake here
            launch = self.launch[-(-cases // _THREADS), _THREADS]
        fresh, running = True, True
        while running:
            launch(there, fresh, _STRETCH, *constants, channels, *results)
            running = bool((there[length + stepper.OUTCOME].copy_to_host() == RUNNING).any())
            fresh = False
        for motion, result in zip(motions, results, strict=True):
            result.copy_to_host(motion)
        kept = there.copy_to_host()
        state = kept[length:]
        outcome, reached, accepted, held, unbelieved = (
            state[place].astype(np.int64)
            for place in (stepper.OUTCOME, stepper.SAMPLE, stepper.ACCEPTED, stepper.HELD_AT, stepper.UNBELIEVED)
        )
        # Samples since the closures last held are of no use where they are lost.
        reached = np.where((outcome == DIVERGING) & (unbelieved >= PATIENCE), held, reached)
        finals = np.vstack([state[stepper.NOW], kept[moving], kept[remembered]]).T
        return Ends(outcome, reached, accepted, finals)


def compile_device(model: Model, scales: Sequence[float], recorded: tuple[int, ...]) -> DeviceKernel:
    """Compile a model for the device; parameters as :func:`jointplay.solver.integrators.kernel.adaptive_code`.

    The compiler itself runs at the first launch.
    """
    code = adaptive_code(model, scales, recorded, SCALAR)
    rows = StepRows(code.layout, len(model.contacts), recorded)
    return DeviceKernel(code, rows, cuda.jit(case_kernel(code, rows, model.remembering)))
