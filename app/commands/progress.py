"""Progress on a terminal as a bar, elsewhere as plain lines now and then."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Never

import click

from jointplay.app.jobs.heartbeat import Heartbeat

if TYPE_CHECKING:
    from tqdm import tqdm

SECONDS_BETWEEN_LINES = 5.0


class ProgressLine:
    """Shows how far long work is; everything goes to stderr.

    Parameters
    ----------
    label : str
        What is done.
    unit : str
        What is counted.
    """

    def __init__(self, label: str, unit: str) -> None:
        self._label = label
        self._unit = unit
        self._bar: tqdm[Never] | None = None
        self._terminal = sys.stderr.isatty()
        self._told = time.monotonic()
        self._done = -1
        self._last = ""
        self._heartbeat = Heartbeat(self._still)

    def __enter__(self) -> ProgressLine:
        self._heartbeat.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._heartbeat.__exit__(kind, error, trace)
        if self._bar is not None:
            self._bar.close()

    def _still(self, seconds: float) -> None:
        """Tell that the work goes on, though nothing new is done."""
        if self._bar is not None:
            self._bar.refresh()
        elif self._terminal or self._last:
            click.echo(f"{self._last or self._label}: at work for {clock(seconds)}", err=True)

    def show(self, done: int, total: int, *, rate: float | None = None, left: float | None = None) -> None:
        """Show that `done` of `total` are done.

        Parameters
        ----------
        done, total : int
        rate : float, optional
            How many a second; a terminal's bar finds its own.
        left : float, optional
            Time to go [s].
        """
        if self._terminal:
            self._draw(done, total)
        elif done != self._done and (
            done == total or self._done < 0 or time.monotonic() - self._told >= SECONDS_BETWEEN_LINES
        ):
            pace = f", {rate:.1f} a second" if rate else ""
            pace += f", {clock(left)} left" if left else ""
            self._last = f"{self._label}: {done} of {total} {self._unit}"
            click.echo(f"{self._last}{pace}", err=True)
            self._heartbeat.heard()
            self._told = time.monotonic()
            self._done = done

    def _draw(self, done: int, total: int) -> None:
        bar = self._bar
        if bar is None:
            from tqdm import tqdm

            # Work found done already is where the bar starts, so that the time left is judged from this run alone.
            bar = tqdm(total=total, initial=done, desc=self._label, unit=f" {self._unit}", file=sys.stderr)
            self._bar = bar
        bar.total = total
        bar.update(done - bar.n)


def clock(seconds: float) -> str:
    """A duration as people read it: 40 s, 3:20 min, 2:05 h."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02d} min"
    return f"{whole // 3600}:{whole % 3600 // 60:02d} h"
