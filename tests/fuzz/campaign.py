"""``python -m fuzz.campaign [machines] [workers]``: random machines; every ending is kept, so that a run resumes."""

from __future__ import annotations

import json
import multiprocessing
import sys
import time
import traceback
from collections import Counter
from pathlib import Path
from typing import Any
from unittest import mock

from fuzz.judge import judge
from fuzz.machines import scene
from fuzz.uncompiled import uncompiled

from jointplay.solver.simulation import runs

#: Trial steps in plain Python, some seconds.
TRIALS = 3000
#: Trial steps of a machine that is too stiff for that, through the compiled lanes.
COMPILED_TRIALS = 1e6
KEPT = Path("build/fuzz.jsonl")


def ending(seed: int) -> dict[str, Any]:
    """How the machine of a seed ends; ``faulty`` with the reason where it must not end so."""
    began = time.process_time()
    try:
        drawn = scene(seed)
        with uncompiled(TRIALS):
            verdict = judge(drawn)
        if verdict.ending == "step_too_small":
            with mock.patch.multiple(runs, _LEAST_PATIENCE=COMPILED_TRIALS, _MOST_PATIENCE=COMPILED_TRIALS):
                verdict = judge(drawn)
        found = {"ending": verdict.ending, "confirmed": verdict.confirmed, "message": verdict.message, "odd": drawn.odd}
    except Exception as error:  # a failure is a result here, whatever it is
        where = traceback.format_exc().strip().splitlines()[-3:]
        found = {"ending": "faulty", "confirmed": False, "message": f"{type(error).__name__}: {error}", "where": where}
    return {"seed": seed, **found, "seconds": round(time.process_time() - began, 2)}


def main(machines: int = 2000, workers: int = 2) -> int:
    KEPT.parent.mkdir(exist_ok=True)
    done = [json.loads(line) for line in KEPT.read_text().splitlines()] if KEPT.exists() else []
    known = {row["seed"] for row in done}
    left = [seed for seed in range(machines) if seed not in known]
    print(f"{len(known)} known in {KEPT}, {len(left)} to do", flush=True)
    with multiprocessing.get_context("spawn").Pool(workers) as pool, KEPT.open("a") as kept:
        for row in pool.imap_unordered(ending, left):
            kept.write(json.dumps(row) + "\n")
            kept.flush()
            done.append(row)
            if row["ending"] == "faulty":
                print(f"seed {row['seed']}: {row['message']}", flush=True)
    counts = Counter(row["ending"] + (", confirmed" if row["confirmed"] else "") for row in done)
    print("\n".join(f"{count:6} {name}" for name, count in counts.most_common()))
    return 1 if counts["faulty"] else 0


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
