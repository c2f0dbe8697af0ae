"""What is compiled, how often, and for whom."""

import json
import os
import subprocess
import sys

import pytest

from boresight.cameras import CAMERA_MODELS
from boresight.kernels.compilation import LOOPS, state_type

#: Compiles some loops as a compiling process does, and counts what Numba is asked for, by function and types.
COUNTED = """
import json
import sys
from collections import Counter
from boresight.cameras import CAMERA_MODELS
from boresight.kernels import compilation, quick_compilation
from numba.core import compiler

compilation.compiles_itself = True
quick_compilation.shorten_compilation()
asked, compile_core = Counter(), compiler.CompilerBase._compile_core

def count(self):
    asked[self.state.func_id.modname, self.state.func_id.func_qualname, self.state.args] += 1
    return compile_core(self)

compiler.CompilerBase._compile_core = count
for camera in sys.argv[2:]:
    for (module, name), loop in compilation.LOOPS.items():
        if name in sys.argv[1].split(","):
            loop.dispatcher.compile(loop.signature(compilation.state_type(CAMERA_MODELS[camera].state)))
    ours = {key[:2]: times for key, times in asked.items() if key[0].startswith("boresight")}
    print(json.dumps([f"{module.removeprefix('boresight.')}.{name}" for module, name in ours]), max(ours.values()), sep="\t")
    asked.clear()
"""


def counted(loops, cameras, folder):
    done = subprocess.run(
        [sys.executable, "-c", COUNTED, loops, *cameras],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"NUMBA_CACHE_DIR": str(folder)},
    )
    lines = (line.split("\t") for line in done.stdout.splitlines())
    return [(set(json.loads(names)), int(most)) for names, most in lines]


@pytest.mark.full
def test_a_part_is_compiled_once_whichever_loops_and_parts_call_it(tmp_path):
    ((functions, most),) = counted("whitened_rows,normal_equations", ["inverted_wang"], tmp_path)
    assert most == 1
    assert {name.rpartition(".")[2] for name in functions if name.startswith("kernels.arclengths")} == {
        "whitened_rows", "normal_equations", "_exposure_rows", "_add_products", "_stars", "_free_columns", "_arcs", "_pad",
        "_largest_exposure", "_width", "_sine_and_cosine", "angle",
    }  # fmt: skip


@pytest.mark.full
def test_a_second_camera_compiles_only_what_touches_its_state(tmp_path):
    (first, _), (second, most) = counted("rays,order_stars", ["inverted_wang", "pinhole_radial"], tmp_path)
    assert most == 1
    seen = "kernels.star.define.<locals>._star.<locals>.<lambda>"  # what a star's direction is made by
    assert {"kernels.arclengths.rays", seen} <= first & second
    assert not {name for name in second - first if not name.startswith("cameras.pinhole_radial.")}
    assert not {name for name in second if name.endswith("order_stars")}


@pytest.mark.parametrize(
    "name", [name for name, loop in LOOPS.items() if not loop.takes_camera], ids=lambda name: name[1]
)
def test_a_loop_without_a_camera_has_one_form(name):
    loop = LOOPS[name]
    assert len({loop.signature(state_type(camera.state)) for camera in CAMERA_MODELS.values()}) == 1
