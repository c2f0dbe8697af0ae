"""Compiles loops in processes of its own: `python -m boresight.kernels.workshop`, two at a time, each loop in one of them.

The loops that take longest are handed out first, and each process gets the next when it is done with one, so that both end at about
the same time. A process is handed (module, name, types) on standard input, pickled, and answers each with a line.
"""

from __future__ import annotations

import importlib
import os
import pickle
import subprocess
import sys
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

import numba

import boresight.kernels
from boresight.kernels.compilation import LOOPS, one_at_a_time, state_type
from boresight.kernels.quick_compilation import shorten_compilation
from boresight.waiting import tell

PROCESSES = 2
#: Loops that take longest to compile, in that order; the others take about as long as each other.
LONGEST = (
    "match_frames", "unscented_filter", "square_root_filter", "judge_selections", "factor_values", "order_stars",
    "normal_equations", "attitudes", "factor_pairs", "spline_sums", "value_rows", "whiten_pairs",
)  # fmt: skip

Task = tuple[str, str, tuple[Any, ...]]  # module, name, types


def make(name: tuple[str, str], types: Sequence[Any]) -> None:
    """Compile one loop, and with it those that are needed where it is."""
    _declare_all()
    wanted = LOOPS[name]
    camera = wanted.find_camera(types)
    mates = (
        (module, other, loop.signature(camera))
        for (module, other), loop in LOOPS.items()
        if (module, other) != name
        and loop.first == wanted.first
        and (not loop.takes_camera or (wanted.first and camera is not None))
        and (wanted.first or not wanted.takes_camera)
    )
    compile_all([(*name, tuple(types)), *mates])


def make_all(states: Iterable[type[Any]]) -> None:
    """Compile every loop there is for cameras with these states."""
    _declare_all()
    compile_all(
        [
            (module, name, loop.signature(camera))
            for (module, name), loop in LOOPS.items()
            for camera in (map(state_type, states) if loop.takes_camera else (None,))
        ]
    )


def _declare_all() -> None:
    for module in iter_modules(boresight.kernels.__path__, "boresight.kernels."):
        importlib.import_module(module.name)


def compile_all(tasks: Sequence[Task]) -> None:
    """Compile loops into the folder, in two processes; what is there already, or is being made by somebody else, is left alone."""
    if not _missing(tasks):
        return
    with one_at_a_time():
        _compile(_missing(tasks))


def _missing(tasks: Iterable[Task]) -> list[Task]:
    return [task for task in tasks if not LOOPS[task[:2]].is_kept(task[2])]


def _compile(tasks: Sequence[Task]) -> None:
    """Hand the loops out, longest first."""
    order = {name: place for place, name in enumerate(LONGEST)}
    done, left = count(), iter(sorted(tasks, key=lambda task: order.get(task[1], len(LONGEST))))

    def work() -> None:
        process = subprocess.Popen(  # noqa: S603 - the program that runs, and a name of its own
            [sys.executable, "-m", __name__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=_environment()
        )
        with process as served:
            if served.stdin is None or served.stdout is None:
                return
            for task in left:  # taking from it is one step of the interpreter
                tell(f"compiling kernels (once per machine): {task[1]}", next(done) / len(tasks))
                pickle.dump(task, served.stdin)
                served.stdin.flush()
                if not served.stdout.readline():
                    return  # it ended: whoever needs the loop compiles it
            served.stdin.close()

    with ThreadPoolExecutor(PROCESSES) as pool:
        for one in [pool.submit(work) for _ in range(min(PROCESSES, len(tasks)))]:
            one.result()


def _environment() -> dict[str, str]:
    """Return the environment of a compiling process: our folder, our modules, and no threads that it has no use for."""
    told = numba.config.CACHE_DIR
    return os.environ | {
        "NUMBA_CACHE_DIR": str(Path(told).parent) if told else "",
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
        "OPENBLAS_NUM_THREADS": "1",
    }


def serve() -> None:
    """Compile what standard input names, until it ends."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print is no answer
    shorten_compilation()
    while True:
        try:
            module, name, types = pickle.load(sys.stdin.buffer)  # noqa: S301 - of the process that started this one
        except EOFError:
            return
        getattr(importlib.import_module(module), name).compile(types)
        answers.write(b"done\n")
        answers.flush()


if __name__ == "__main__":
    boresight.kernels.compilation.compiles_itself = True
    serve()
